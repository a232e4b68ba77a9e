"""Predicted wrench and tilt by the identified models (thesis figure 5-6, chapter 1).

The wrench under an arm follows from the arm's motion and weight; the tilt of the base follows from
that wrench, through the identified springs. `surrogate` says when these predictions are used.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.rigid_motion import FrameMotion
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.base_motion import BaseMotionFilter, level_of
from controllers.motion.base_tilt import TiltAxis, moment_variances, tilting_moments
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from perception.geometry.gravity import GRAVITY
from perception.geometry.se3 import cross_matrix
from twin.robot import Observation

_AT_REST = 0.15  # Tachometers of wheels at rest read less [rad/s].
_SETTLES = 0.5  # Time for which the base still swings when the wheels have stopped [s].
_DISTURBED = 0.1  # Time for which what shakes the base stays about the same [s].
_NO_TILT = float(scipy.stats.chi2.isf(1e-3, 6))  # Squared distance, whitened.
_SAME_POSE = 0.02  # Joint angles within which slopes are taken as the same [rad].

_MOMENT_TIME = 0.1  # Time for which an unknown moment stays about the same [s].


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
    """Arm, and the uncertainties of what the wrench under it follows from.

    Attributes:
        arm: The arm with what it carries, as identified.
        mount: (3,) its base from the accelerometer, in the body frame [m].
        grip: (3,) where the hand touches things, in the last link's frame [m].
        lag: Time constant of the filter that makes accelerations of rates [s].
        rate_noise: Standard deviation of a rate [rad/s].
        jerk: Usual jerk of the joints: what the lag leaves out is this times it [rad/s^3].
        tilt: Standard deviation of the base's tilt about each axis [rad].
        base_acceleration: Standard deviation of the base's acceleration without an accelerometer
            [m/s^2].
        base_turning: Standard deviation of its angular acceleration without a gyro [rad/s^2].
        driven: Both of these with turning wheels, as wheels shake the base [m/s^2, rad/s^2]; on
            rough ground at 6 cm/s 0.6 m/s^2 were measured, with peaks of 4.
        accelerometer_noise: Standard deviation of its samples [m/s^2].
        gyro_noise: Standard deviation of the gyro's samples [rad/s].
        mass: Relative standard deviation of the arm's mass.
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
    contact: float = 5.0
    contact_radius: float = 0.06

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        names = [field.name for field in dataclasses.fields(self) if field.type is float]
        check_numbers("wrench model", self, *names, zero=True)
        for name in ("mount", "grip"):
            value = np.asarray(getattr(self, name))
            if value.shape != (3,) or not np.all(np.isfinite(value)):
                raise ValueError(f"wrench model {name}: got {value}, needs 3 finite numbers")


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
        tilt: ArrayLike | None = None,
    ) -> Prediction:
        """Return the wrench by the rover on the arm, in and about the arm base frame.

        The hand is assumed to touch nothing.

        Args:
            observation: Observation with arm angles and rates usable; the base's motion is taken
                from accelerometer, gyro and inclinometer as far as they are.
            dt: Time since the observation before [s].
            tilt: (2,) deviations of pitch and roll where the inclinometer's channel is itself
                predicted [rad]; None where it is measured.

        Returns:
            (6,) force [N] and moment [N m].

        Raises:
            ValueError: If angles or rates are missing or not finite, or dt is not positive.
        """
        angles, rates = _joints(observation)
        if not dt > 0.0:
            raise ValueError(f"wrench model dt: got {dt}, needs a positive time [s]")
        keep = math.exp(-dt / self.config.lag) if self.config.lag > 0.0 else 0.0
        if self._rates is not None:
            fresh = (rates - self._rates) / dt
            self._accelerations = keep * self._accelerations + (1.0 - keep) * fresh
        self._rates = rates
        motion, known = self._motion(observation, dt)
        wrench = self._chain.inverse_dynamics(angles, rates, self._accelerations, motion)[1]
        driving = observation.wheel_speeds.usable and bool(
            np.max(np.abs(observation.wheel_speeds.value)) > _AT_REST
        )
        self._shaken = _SETTLES if driving else max(self._shaken - dt, 0.0)
        sigma = self._uncertain(motion, dt, keep, known)
        if tilt is not None:
            turned = slice(len(angles), len(angles) + 3)
            unsure = _tilted(motion, [*np.asarray(tilt, dtype=float), 0.0])
            sigma[turned] = np.hypot(sigma[turned], unsure)
        slopes = np.column_stack([self._by_motion(angles), wrench])
        covariance = slopes @ np.diag(sigma**2) @ slopes.T
        return Prediction(wrench, covariance + 1e-12 * np.eye(6))

    def contact_covariance(self, observation: Observation) -> FloatArray:
        """Return (6, 6) what contact at the hand may add to the wrench's covariance.

        Args:
            observation: Observation with the arm's angles.
        """
        angles, _ = _joints(observation)
        force, moment = self.config.contact, self.config.contact * self.config.contact_radius
        # Alike along all axes, so that the hand's attitude plays no part.
        by_force = np.vstack([np.eye(3), cross_matrix(self._chain.tool_frame(angles)[:3, 3])])
        covariance = force**2 * by_force @ by_force.T
        covariance[3:, 3:] += moment**2 * np.eye(3)
        return covariance

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
            observation: Observation with the arm's angles and the estimated tilt.
            expected: Result of `predict` for it, with the same ``tilt``.
            wrench: (6,) measured [N, N m].
            noise: (6, 6) covariance of it.
            tilt: (2,) deviations of the estimated pitch and roll [rad].
            dt: Time since the observation before [s].

        Returns:
            (2,) pitch and roll to add [rad]; None for a wrench that no tilt explains, as of a hand
            that touches something.
        """
        angles, _ = _joints(observation)
        by_force = self._by_motion(angles)[:, len(angles) : len(angles) + 3]
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

    def _motion(self, observation: Observation, dt: float) -> tuple[FrameMotion, bool]:
        if self._base is None:
            self._base = BaseMotionFilter(self.config.lag, dt)
        measured = self._base.update(observation)
        if measured is None:
            return level_of(observation), False
        return measured.at(self.config.mount), True

    def _by_motion(self, angles: FloatArray) -> FloatArray:
        """Return (6, n + 6) change of the wrench by accelerations; it changes little in a tick.

        Columns are the accelerations of the joints, then linear and angular of the base.
        """
        if self._slopes is not None and np.max(np.abs(self._slopes[0] - angles)) < _SAME_POSE:
            return self._slopes[1]
        count = len(angles)
        units = np.eye(count + 6)
        base = FrameMotion(
            units[:, count : count + 3], np.zeros((count + 6, 3)), units[:, count + 3 :]
        )
        poses, still = np.tile(angles, (count + 6, 1)), np.zeros((count + 6, count))
        slopes = self._chain.inverse_dynamics(poses, still, units[:, :count], base)[1].T
        self._slopes = angles, slopes
        return slopes

    def _uncertain(self, motion: FrameMotion, dt: float, keep: float, known: bool) -> FloatArray:
        """Return (n + 7,) sigmas of the result of `_by_motion`, and of the mass's part."""
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


@dataclasses.dataclass(frozen=True)
class TiltModelConfig:
    """Tilt of a base on its springs, and the inclinometer's reading of it.

    Attributes:
        pitch: Tilt of the base about x.
        roll: Tilt of the base about y, as pitch of a rover turned a quarter to its right.
        noise: Standard deviation of the inclinometer's samples [rad].
        bandwidth: First-order corner frequency of the inclinometer [Hz].
        height: Its height over the arm's base [m]: it refers to the specific force at its place.
        moment: Standard deviation of the moment that the model does not know [N m].
        ground_drift: Growth of the slope's deviation at rest [rad/sqrt(s)].
        drive_drift: Growth of the slope's deviation by driving [rad/sqrt(m)]. Measured over 0.4 m
            of ground with 2 cm of relief and rocks of 2 to 5 cm: 0.157 in pitch, 0.112 in roll
            (r.m.s., 24 fields).
        wheel_radius: Radius of the wheels, for the distance driven [m].
    """

    pitch: TiltAxis
    roll: TiltAxis
    noise: float = math.radians(0.05)
    bandwidth: float = 6.0
    height: float = -0.036
    moment: float = 0.02
    ground_drift: float = 1e-4
    drive_drift: float = 0.16
    wheel_radius: float = 0.08

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        names = [field.name for field in dataclasses.fields(self) if field.type is float]
        names.remove("height")
        check_numbers("tilt model", self, *names)


class TiltModel:
    """Predicts pitch and roll of a base from the wrench under its arm, through its springs.

    Of each axis four numbers are estimated: swing, its rate, the inclinometer's filtered reading
    of the specific force that goes with it, and the slope on which the base swings. While the
    inclinometer works it corrects them.

    Args:
        config: Springs of the base, and the inclinometer.
    """

    def __init__(self, config: TiltModelConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget all; the next wrench is that of rest."""
        self._rest: FloatArray | None = None
        self._states = np.zeros((2, 4))
        # The slope may be any that a rover bears.
        initial = np.diag(np.square([0.01, 0.1, 0.01, 0.3]))
        self._covariances = np.array([initial, initial])
        self._steps: tuple[float, list[tuple[FloatArray, FloatArray, FloatArray]]] | None = None

    def predict(
        self, observation: Observation, dt: float, wrench_covariance: ArrayLike | None = None
    ) -> Prediction:
        """Return pitch and roll as the inclinometer should show them, without using it.

        Args:
            observation: Observation with a usable wrench under the arm, measured or predicted, and
                the wheel speeds if there are any.
            dt: Time since the observation before [s].
            wrench_covariance: (6, 6) of the wrench, whose error lasts as an unknown moment's does;
                None for none.

        Returns:
            (2,) [rad]; the inclinometer's noise is not in the covariance.

        Raises:
            ValueError: If the wrench is missing or not finite, or dt is not positive.
        """
        if not dt > 0.0:
            raise ValueError(f"tilt model dt: got {dt}, needs a positive time [s]")
        wrench = np.asarray(observation.arm_base_wrench.value, dtype=float)
        if wrench.shape != (6,) or not np.all(np.isfinite(wrench)):
            raise ValueError(f"tilt model: arm_base_wrench {wrench}, needs six finite numbers")
        if self._rest is None:
            self._rest = wrench
        turns = tilting_moments(self.config.pitch, self.config.roll)
        change = wrench - self._rest
        moments = turns @ change
        unsure = moment_variances(self.config.pitch, self.config.roll, change)
        unsure += self.config.moment**2
        if wrench_covariance is not None:
            unsure += np.einsum("ij,jk,ik->i", turns, np.asarray(wrench_covariance), turns)
        drift = self.config.ground_drift**2 * dt + self.config.drive_drift**2 * self._driven(
            observation, dt
        )
        for axis, (step, push, noise) in enumerate(self._transitions(dt)):
            self._states[axis] = step @ self._states[axis] + push * moments[axis]
            covariance = step @ self._covariances[axis] @ step.T + unsure[axis] * noise
            covariance[3, 3] += drift
            self._covariances[axis] = covariance
        shown = self._states[:, 2] + self._states[:, 3]
        read = np.array([0.0, 0.0, 1.0, 1.0])
        return Prediction(shown, np.diag(read @ self._covariances @ read))

    def correct(self, tilt: ArrayLike) -> None:
        """Correct by an accepted sample of the inclinometer, after `predict`.

        Args:
            tilt: (2,) pitch and roll [rad].
        """
        values = np.asarray(tilt, dtype=float)
        self._take(values, np.full(2, self.config.noise**2), np.array([0.0, 0.0, 1.0, 1.0]))

    def weigh(self, tilt: Prediction) -> None:
        """Take the tilt by the weight of the arm, undelayed, after `predict`.

        Args:
            tilt: (2,) pitch and roll [rad].
        """
        self._take(tilt.value, np.diag(tilt.covariance), np.array([1.0, 0.0, 0.0, 1.0]))

    def _take(self, values: FloatArray, variances: FloatArray, read: FloatArray) -> None:
        for axis, (value, variance) in enumerate(zip(values, variances)):
            covariance = self._covariances[axis]
            gain = covariance @ read / (read @ covariance @ read + variance)
            self._states[axis] += gain * (value - read @ self._states[axis])
            self._covariances[axis] = covariance - np.outer(gain, read @ covariance)

    @property
    def tilt(self) -> Prediction:
        """(2,) pitch and roll as they are, not delayed by the inclinometer's filter [rad]."""
        read = np.array([1.0, 0.0, 0.0, 1.0])
        return Prediction(self._states @ read, np.diag(read @ self._covariances @ read))

    def _driven(self, observation: Observation, dt: float) -> float:
        if not observation.wheel_speeds.usable:
            return 0.0
        speeds = np.abs(np.asarray(observation.wheel_speeds.value, dtype=float))
        # Tachometers of wheels at rest read noise.
        moving = float(np.median(speeds))
        return self.config.wheel_radius * moving * dt if moving > 0.05 else 0.0

    def _transitions(self, dt: float) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return of each axis step (4, 4), push (4,) by the moment, noise (4, 4) by its square."""
        if self._steps is None or self._steps[0] != dt:
            self._steps = dt, [self._transition(a, dt) for a in (self.config.pitch,
                                                                 self.config.roll)]  # fmt: skip
        return self._steps[1]

    def _transition(
        self, axis: TiltAxis, dt: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        pole = 2.0 * math.pi * self.config.bandwidth
        flow = np.zeros((5, 5))
        flow[0, 1] = 1.0
        flow[1, [0, 1, 4]] = np.array([-axis.stiffness, -axis.damping, 1.0]) / axis.inertia
        apparent = np.eye(5)[0] - (axis.lever[1] + self.config.height) / GRAVITY * flow[1]
        flow[2] = pole * (apparent - np.eye(5)[2])
        whole = np.asarray(scipy.linalg.expm(flow * dt), dtype=float)
        push = whole[:4, 4]
        return whole[:4, :4], push, np.outer(push, push) * max(_MOMENT_TIME / dt, 1.0)
