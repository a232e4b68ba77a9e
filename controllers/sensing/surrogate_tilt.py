"""How a base should tilt under the wrench of its arm, through its identified springs.

Thesis figure 5-6 and chapter 1: the inclinometer's surrogate. `surrogate` says when to use it.
"""

import dataclasses
import math

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from controllers.motion.base_tilt import TiltAxis, tilting_moments
from controllers.sensing.surrogate_wrench import Prediction
from perception.geometry.arrays import FloatArray
from twin.robot import Observation

_MOMENT_TIME = 0.1  # Time for which an unknown moment stays about the same [s].


@dataclasses.dataclass(frozen=True)
class TiltModelConfig:
    """How a base tilts, and how the inclinometer sees it.

    Attributes:
        pitch: How the base tilts about x.
        roll: How it tilts about y, as pitch of a rover turned a quarter to its right.
        noise: Standard deviation of the inclinometer's samples [rad].
        bandwidth: First-order corner frequency of the inclinometer [Hz].
        moment: Standard deviation of the moment that the model does not know [N m].
        gain: Relative standard deviation of the moment that it knows.
        lever: Standard deviation of the levers [m]: an arm that only swings hardly shows them.
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
    moment: float = 0.02
    gain: float = 0.1
    lever: float = 0.03
    ground_drift: float = 1e-4
    drive_drift: float = 0.16
    wheel_radius: float = 0.08

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        for field in dataclasses.fields(self)[2:]:
            name, value = field.name, getattr(self, field.name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"tilt model {name}: got {value}, needs a positive number")


class TiltModel:
    """Predicts pitch and roll of a base from the wrench under its arm, through its springs.

    Of each axis four numbers are estimated: swing, its rate, the inclinometer's filtered reading
    of it, and the slope on which the base swings. While the inclinometer works it corrects them.

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
        # The slope may be any that a rover stands on.
        initial = np.diag(np.square([0.01, 0.1, 0.01, 0.3]))
        self._covariances = np.array([initial, initial])
        self._steps: tuple[float, list[tuple[FloatArray, FloatArray, FloatArray]]] | None = None

    def predict(
        self, observation: Observation, dt: float, wrench_covariance: ArrayLike | None = None
    ) -> Prediction:
        """Return pitch and roll as the inclinometer should show them, without using it.

        Args:
            observation: With the wrench under the arm usable, measured or predicted, and the wheel
                speeds if there are any.
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
        across = change[2] ** 2 + change[[1, 0]] ** 2
        unsure = self.config.moment**2 + (self.config.gain * moments) ** 2
        unsure += self.config.lever**2 * across
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
        """Take a believed sample of the inclinometer, after `predict`.

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
        flow[2, [0, 2]] = pole, -pole
        whole = np.asarray(scipy.linalg.expm(flow * dt), dtype=float)
        push = whole[:4, 4]
        return whole[:4, :4], push, np.outer(push, push) * max(_MOMENT_TIME / dt, 1.0)
