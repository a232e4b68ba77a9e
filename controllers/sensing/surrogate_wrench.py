"""What the wrench under an arm should be, by the identified model (thesis figure 5-6, chapter 1).

It follows from how the arm moves and, where the motors' efforts are known, from what it touches.
`surrogate` says when to use it.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.frame_motion import FrameMotion
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.base_motion import BaseFilterConfig, BaseMotionFilter, level_of
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import adjoint, cross_matrix
from twin.robot import Observation

_AT_REST = 0.15  # Tachometers of wheels at rest read less [rad/s].
_SETTLES = 0.5  # Time for which the base still swings when the wheels have stopped [s].
_DISTURBED = 0.1  # Time for which what shakes the base stays about the same [s].
_NO_TILT = float(scipy.stats.chi2.isf(1e-3, 6))  # Squared distance, whitened.
_SAME_POSE = 0.02  # Joint angles within which slopes are taken as the same [rad].


class Prediction(NamedTuple):
    """An uncertain value.

    Attributes:
        value: (n,).
        covariance: (n, n).
    """

    value: FloatArray
    covariance: FloatArray


@dataclasses.dataclass(frozen=True)
class WrenchModelConfig:
    """What the wrench under an arm follows from, and how well that is known.

    Attributes:
        arm: The arm with what it carries, as identified.
        mount: (3,) its base from the accelerometer, in the body frame [m].
        grip: (3,) where the hand touches things, in the last link's frame [m].
        lag: Time constant of the filter that makes accelerations of rates [s].
        rate_noise: Standard deviation of a rate [rad/s].
        jerk: Usual jerk of the joints: what the lag leaves out is this times it [rad/s^3].
        tilt: Standard deviation of the base's tilt about each axis [rad].
        base_acceleration: The same of the base's motion without an accelerometer [m/s^2].
        base_turning: The same of its angular acceleration without a gyro [rad/s^2].
        driven: Both of these with turning wheels, as wheels shake the base [m/s^2, rad/s^2]; on
            rough ground at 6 cm/s 0.6 m/s^2 were measured, with peaks of 4.
        accelerometer_noise: Standard deviation of its samples [m/s^2].
        gyro_noise: The same of the gyro's [rad/s].
        mass: Relative standard deviation of the arm's mass.
        friction: (4,) dry friction of the joints [N m]; what a joint's effort cannot show.
        contact: Standard deviation of a force at the hand before anything is measured [N].
        contact_radius: Distance from the grip point within which things touch [m].
    """

    arm: SerialChain
    mount: FloatArray
    grip: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    lag: float = 0.02
    rate_noise: float = 0.01
    jerk: float = 10.0
    tilt: float = 0.002
    base_acceleration: float = 0.05
    base_turning: float = 0.3
    driven: tuple[float, float] = (1.0, 1.0)
    accelerometer_noise: float = 0.05
    gyro_noise: float = 0.005
    mass: float = 0.01
    friction: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(4))
    contact: float = 5.0
    contact_radius: float = 0.06

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if isinstance(value, float) and not 0.0 <= value < math.inf:
                raise ValueError(f"wrench model {name}: got {value}, needs a finite number >= 0")
        for name, count in (("mount", 3), ("grip", 3), ("friction", len(self.arm))):
            value = np.asarray(getattr(self, name))
            if value.shape != (count,) or not np.all(np.isfinite(value)):
                raise ValueError(f"wrench model {name}: got {value}, needs {count} finite numbers")


class WrenchModel:
    """Predicts the wrench under an arm from its motion, and the force at its hand from efforts.

    Args:
        config: Arm, and the uncertainties of what the wrench follows from.
    """

    def __init__(self, config: WrenchModelConfig) -> None:
        self.config = config
        hand = RigidTransform.from_translation(config.grip)
        base = RigidTransform.identity()
        self._chain = dataclasses.replace(
            config.arm, transform_tool_to_link=hand, transform_base_to_robot=base
        )
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._rates: FloatArray | None = None
        self._accelerations = np.zeros(len(self._chain))
        self._base: BaseMotionFilter | None = None
        self._shaken = 0.0
        self._slopes: tuple[FloatArray, FloatArray] | None = None

    def predict(
        self,
        observation: Observation,
        dt: float,
        efforts: ArrayLike | None = None,
        tilt: ArrayLike | None = None,
    ) -> Prediction:
        """Return the wrench by the rover on the arm, in and about the arm base frame.

        Without efforts the hand is taken to touch nothing.

        Args:
            observation: With arm angles and rates usable; the base's motion is taken from
                accelerometer, gyro and inclinometer as far as they are.
            dt: Time since the observation before [s].
            efforts: (4,) efforts of the motors at the joints, with friction [N m]: then the
                force at the hand is found from them and is part of the wrench.
            tilt: (2,) deviations of pitch and roll where the inclinometer's channel is itself
                predicted [rad]; None where it is measured.

        Returns:
            (6,) force [N] and moment [N m].

        Raises:
            ValueError: If angles or rates are missing or not finite, or dt is not positive.
        """
        wrench, covariance, joints = self._free(observation, dt, tilt)
        if efforts is None:
            return Prediction(wrench, covariance)
        by_efforts, by_wrench = self._contact_maps(observation)
        touch = self._touch(by_efforts, np.asarray(efforts, dtype=float) - joints.value, joints)
        return Prediction(
            wrench + by_wrench @ touch.value,
            covariance + by_wrench @ touch.covariance @ by_wrench.T,
        )

    def contact_force(self, observation: Observation, dt: float, efforts: ArrayLike) -> Prediction:
        """Return force and moment of the hand on the world, about the grip point, from efforts.

        Four joints determine four of the six; the others keep their prior.

        Args:
            observation: Observation with arm angles and rates usable.
            dt: Time since the observation before [s].
            efforts: (4,) efforts of the motors at the joints [N m].

        Returns:
            (6,) in the last link's frame [N, N m].
        """
        _, _, joints = self._free(observation, dt)
        by_efforts, _ = self._contact_maps(observation)
        return self._touch(by_efforts, np.asarray(efforts, dtype=float) - joints.value, joints)

    def contact_from_wrench(
        self, free: Prediction, wrench: ArrayLike, noise: ArrayLike, observation: Observation
    ) -> Prediction:
        """Return force and moment of the hand on the world, about the grip point, from a wrench.

        Args:
            free: Prediction without contact.
            wrench: (6,) measured [N, N m].
            noise: (6, 6) covariance of it.
            observation: With the arm's angles.
        """
        _, by_wrench = self._contact_maps(observation)
        extra = np.asarray(wrench, dtype=float) - free.value
        return _update(self._before(), by_wrench, extra, free.covariance + np.asarray(noise))

    def contact_covariance(self, observation: Observation) -> FloatArray:
        """Return (6, 6) what contact at the hand may add to the wrench's covariance.

        Args:
            observation: With the arm's angles.
        """
        _, by_wrench = self._contact_maps(observation)
        return by_wrench @ self._before() @ by_wrench.T

    def tilt_error(
        self,
        observation: Observation,
        expected: Prediction,
        wrench: ArrayLike,
        noise: ArrayLike,
        tilt: ArrayLike,
        dt: float,
    ) -> Prediction | None:
        """Return the error of the tilt by the direction of the arm's weight.

        Args:
            observation: With the arm's angles, and the tilt as it is believed.
            expected: Result of `predict` for it, with the same ``tilt``.
            wrench: (6,) measured [N, N m].
            noise: (6, 6) covariance of it.
            tilt: (2,) deviations of the believed pitch and roll [rad].
            dt: Time since the observation before [s].

        Returns:
            (2,) pitch and roll to add [rad]; None for a wrench that no tilt explains, as of a hand
            that touches something.
        """
        angles, _ = _joints(observation)
        by_force = self._by_motion(angles)[:6, len(angles) : len(angles) + 3]
        by_tilt = by_force @ _force_by_tilt(observation)
        unsure = np.asarray(tilt, dtype=float)
        tilted = np.square(_tilted(level_of(observation), [*unsure, 0.0]))
        covariance = expected.covariance - (by_force * tilted) @ by_force.T + np.asarray(noise)
        off = np.asarray(wrench, dtype=float) - expected.value
        whole = covariance + by_tilt @ np.diag(unsure**2) @ by_tilt.T
        if off @ np.linalg.solve(whole, off) > _NO_TILT:
            return None
        weights = np.linalg.solve(covariance, by_tilt).T
        posterior = np.asarray(np.linalg.inv(weights @ by_tilt), dtype=float)
        # What shakes the base stays about the same for a while, and counts once.
        return Prediction(posterior @ weights @ off, posterior * max(_DISTURBED / dt, 1.0))

    def _touch(self, by_efforts: FloatArray, extra: FloatArray, joints: Prediction) -> Prediction:
        noise = joints.covariance + np.diag(self.config.friction**2)
        return _update(self._before(), by_efforts, extra, noise)

    def _before(self) -> FloatArray:
        force, moment = self.config.contact, self.config.contact * self.config.contact_radius
        return np.diag(np.square([force] * 3 + [moment] * 3))

    def _free(
        self, observation: Observation, dt: float, tilt: ArrayLike | None = None
    ) -> tuple[FloatArray, FloatArray, Prediction]:
        """Return wrench, its covariance, and the joints' efforts, with nothing touched."""
        if not dt > 0.0:
            raise ValueError(f"wrench model dt: got {dt}, needs a positive time [s]")
        angles, rates = _joints(observation)
        keep = math.exp(-dt / self.config.lag) if self.config.lag > 0.0 else 0.0
        if self._rates is not None:
            fresh = (rates - self._rates) / dt
            self._accelerations = keep * self._accelerations + (1.0 - keep) * fresh
        self._rates = rates
        motion, known = self._motion(observation, dt)
        wrench, efforts = self._dynamics(angles, rates, self._accelerations, motion)
        driving = observation.wheel_speeds.usable and bool(
            np.max(np.abs(observation.wheel_speeds.value)) > _AT_REST
        )
        if driving:
            self._shaken = _SETTLES
        else:
            self._shaken = max(self._shaken - dt, 0.0)
        sigma = self._uncertain(motion, dt, keep, known)
        if tilt is not None:
            count = len(angles)
            sigma[count : count + 3] = np.hypot(
                sigma[count : count + 3], _tilted(motion, [*np.asarray(tilt, dtype=float), 0.0])
            )
        both = np.concatenate([wrench, efforts])
        slopes = np.column_stack([self._by_motion(angles), both])
        covariance = slopes @ np.diag(sigma**2) @ slopes.T
        covariance += 1e-12 * np.eye(len(covariance))
        return wrench, covariance[:6, :6], Prediction(efforts, covariance[6:, 6:])

    def _motion(self, observation: Observation, dt: float) -> tuple[FrameMotion, bool]:
        if self._base is None:
            self._base = BaseMotionFilter(BaseFilterConfig(self.config.lag, dt))
        measured = self._base.update(observation)
        if measured is None:
            return level_of(observation), False
        return measured.at(self.config.mount), True

    def _dynamics(
        self, angles: FloatArray, rates: FloatArray, accelerations: FloatArray, base: FrameMotion,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        efforts, wrench = self._chain.inverse_dynamics(angles, rates, accelerations, base)
        return wrench, efforts

    def _by_motion(self, angles: FloatArray) -> FloatArray:
        """Return (6 + n, n + 6) change of wrench and efforts by the accelerations.

        Of the joints, then linear and angular of the base. They change little from tick to tick.
        """
        if self._slopes is not None and np.max(np.abs(self._slopes[0] - angles)) < _SAME_POSE:
            return self._slopes[1]
        count, still = len(angles), FrameMotion(np.zeros(3), np.zeros(3), np.zeros(3))
        none = np.zeros(count)
        columns = [self._dynamics(angles, none, unit, still) for unit in np.eye(count)]
        for unit in np.eye(3):
            pushed = dataclasses.replace(still, specific_force=unit)
            columns.append(self._dynamics(angles, none, none, pushed))
        for unit in np.eye(3):
            turned = dataclasses.replace(still, angular_acceleration=unit)
            columns.append(self._dynamics(angles, none, none, turned))
        self._slopes = angles, np.column_stack([np.concatenate(both) for both in columns])
        return self._slopes[1]

    def _uncertain(self, motion: FrameMotion, dt: float, keep: float, known: bool) -> FloatArray:
        """Return (n + 7,) deviations of what `_by_motion` stands for, and of the mass's part."""
        config = self.config
        # White noise, differenced and then filtered; and filtered alone.
        shaken = (1.0 - keep) / dt * math.sqrt(2.0 / (1.0 + keep))
        smoothed = math.sqrt((1.0 - keep) / (1.0 + keep))
        joint = math.hypot(config.rate_noise * shaken, config.lag * config.jerk)
        linear, angular = config.base_acceleration, config.base_turning
        if self._shaken > 0.0:
            linear, angular = max(linear, config.driven[0]), max(angular, config.driven[1])
        moved = np.array([linear] * 3 + [angular] * 3)
        if known:
            moved[:3] = math.hypot(config.accelerometer_noise * smoothed, 0.5 * moved[0])
            moved[3:] = math.hypot(config.gyro_noise * shaken, 0.5 * moved[3])
        moved[:3] = np.hypot(moved[:3], _tilted(motion, np.full(3, config.tilt)))
        return np.concatenate([np.full(len(self._accelerations), joint), moved, [config.mass]])

    def _contact_maps(self, observation: Observation) -> tuple[FloatArray, FloatArray]:
        """Return (n, 6) and (6, 6): efforts and wrench by what the hand does to the world."""
        angles, _ = _joints(observation)
        by_wrench = adjoint(self._chain.tool_in_robot(angles))
        turned = np.kron(np.eye(2), by_wrench[:3, :3])
        return self._chain.jacobian(angles).T @ turned, by_wrench


def motor_efforts(duty: ArrayLike, rates: ArrayLike, stall: float, no_load: float) -> FloatArray:
    """Return (n,) what motors give at their joints, before friction [N m].

    Args:
        duty: (n,) as `Robot.command` returned it.
        rates: (n,) of the joints [rad/s].
        stall: Torque at full duty and rest, before friction [N m].
        no_load: Speed at full duty without any torque [rad/s].
    """
    return stall * (np.asarray(duty, dtype=float) - np.asarray(rates, dtype=float) / no_load)


def _tilted(motion: FrameMotion, tilt: ArrayLike) -> FloatArray:
    """Return (3,) deviations of the specific force by those of the turn about each axis (3,)."""
    return np.sqrt(np.square(cross_matrix(motion.specific_force)) @ np.square(tilt))


def _force_by_tilt(observation: Observation) -> FloatArray:
    """Return (3, 2) how the specific force changes with pitch and roll [m/s^2/rad]."""
    tilt, step = np.asarray(observation.inclinometer.value, dtype=float), 1e-4
    columns: list[FloatArray] = []
    for unit in step * np.eye(2):
        ends = [
            level_of(
                observation._replace(inclinometer=observation.inclinometer._replace(value=value))
            ).specific_force
            for value in (tilt + unit, tilt - unit)
        ]
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.column_stack(columns)


def _joints(observation: Observation) -> tuple[FloatArray, FloatArray]:
    found: list[FloatArray] = []
    for name in ("arm_angles", "arm_rates"):
        channel = getattr(observation, name)
        value = np.asarray(channel.value, dtype=float)
        if not channel.usable or not value.size or not np.all(np.isfinite(value)):
            raise ValueError(f"surrogate: {name} is {channel.validity.value} or not finite; needed")
        found.append(value)
    return found[0], found[1]


def _update(before: FloatArray, seen: FloatArray, value: FloatArray, noise: FloatArray
            ) -> Prediction:  # fmt: skip
    """Return what a linear measurement makes of zero mean with a covariance."""
    gain = np.linalg.solve(seen @ before @ seen.T + noise, seen @ before).T
    after = before - gain @ seen @ before
    return Prediction(gain @ value, 0.5 * (after + after.T))
