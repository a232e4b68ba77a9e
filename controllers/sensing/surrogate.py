"""Surrogate sensing: predictions in place of failed sensors, and when to stop (figure 5-6).

Each tick the identified models predict wrench and tilt. A sample that is missing, not finite,
frozen, or too far off for its covariance (normalised innovation) is replaced; a sensor that stays
so is named as failed until it agrees again. While the inclinometer is lost, the weight of an arm
that touches nothing gives the tilt. When a surrogate's deviation has grown too large, or it has
served too long, the task has to stop, and the reason is given.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike

from controllers.sensing.surrogate_models import Prediction, TiltModel, WrenchModel
from perception.geometry.arrays import FloatArray
from twin.robot import Channel, Observation, Validity

WRENCH, TILT = "arm_base_wrench", "inclinometer"
_FALSE_ALARM = 1e-5
"""Share of good samples that are rejected."""


@dataclasses.dataclass(frozen=True)
class SensorLimits:
    """When a sensor has failed, and how long and how unsure its surrogate may serve.

    Attributes:
        noise: (n,) standard deviations of the sensor's samples.
        largest: (n,) deviations of the predicted value with which the task cannot go on.
        longest: Time for which the surrogate may serve [s].
        failed_after: Time for which samples are bad before the sensor is named failed [s]; a
            shorter fault is a spike.
        recovered_after: Time for which samples are good before a failed sensor is used again [s].
        frozen_after: Time without the slightest change after which it is frozen [s]; infinite for
            a sensor without noise.
    """

    noise: FloatArray
    largest: FloatArray
    longest: float = 5.0
    failed_after: float = 0.05
    recovered_after: float = 0.3
    frozen_after: float = 0.3

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        if np.shape(self.noise) != np.shape(self.largest) or np.ndim(self.noise) != 1:
            shapes = np.shape(self.noise), np.shape(self.largest)
            raise ValueError(f"sensor noise and largest: got shapes {shapes}, need one of (n,)")
        for name in ("noise", "largest"):
            if not np.all(np.asarray(getattr(self, name)) > 0.0):
                raise ValueError(f"sensor {name}: got {getattr(self, name)}, needs numbers above 0")
        for name in ("longest", "failed_after", "recovered_after", "frozen_after"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"sensor {name}: got {getattr(self, name)} s, needs 0 or more")


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Judgement of a sample by a monitor.

    Attributes:
        believed: Whether the sample itself may be used.
        fault: Empty, or ``missing``, ``not finite``, ``frozen``, ``spike`` or ``off``.
        failed: Whether the sensor is failed, not only this sample.
        innovation: Normalised squared innovation over its degrees of freedom; NaN without one.
        stop: Why the task cannot go on; empty if it can.
    """

    believed: bool
    fault: str
    failed: bool
    innovation: float
    stop: str


class SensorMonitor:
    """Judges each sample of one sensor.

    Args:
        name: Name of the channel, for the reasons.
        limits: When the sensor has failed, and how its surrogate may serve.
    """

    def __init__(self, name: str, limits: SensorLimits) -> None:
        self.name = name
        self.limits = limits
        freedom = len(limits.noise)
        self._gate = float(scipy.stats.chi2.isf(_FALSE_ALARM, freedom)) / freedom
        self.reset()

    def reset(self) -> None:
        """Reset the state; the sensor counts as working."""
        self._last: Channel | None = None
        self._innovation = math.nan
        self._fault = ""
        self._failed = False
        self._bad = self._good = self._same = self._served = 0.0

    def step(
        self, channel: Channel, predicted: Prediction, dt: float, allowed: ArrayLike | None = None
    ) -> Verdict:
        """Judge a sample.

        Args:
            channel: The sample as observed.
            predicted: Prediction of the model, without the sensor's noise.
            dt: Time since the step before [s].
            allowed: (n, n) covariance of what the model does not know, such as contact.

        Returns:
            The verdict; a sample that is held between two readings is judged as the reading was.
        """
        fault = self._judge(channel, predicted, dt, allowed)
        if fault:
            self._bad, self._good = self._bad + dt, 0.0
        else:
            self._bad, self._good = 0.0, self._good + dt
        at_once = fault in ("missing", "not finite", "frozen")
        # A tick's rounding must not decide.
        if fault and (at_once or self._bad > self.limits.failed_after - 0.5 * dt):
            self._failed = True
        elif not fault and self._good > self.limits.recovered_after - 0.5 * dt:
            self._failed = False
        if fault == "spike" and self._failed:
            fault = "off"
        if fault or not self._failed:
            self._fault = fault
        believed = not fault and not self._failed
        self._served = 0.0 if believed else self._served + dt
        # However unsure its prediction is, a spike alone stops nothing: it is over soon.
        reason = self._stop(predicted, dt) if self._failed else ""
        return Verdict(believed, self._fault, self._failed, self._innovation, reason)

    def _judge(
        self, channel: Channel, predicted: Prediction, dt: float, allowed: ArrayLike | None
    ) -> str:
        last, self._last = self._last, channel
        if not channel.usable:
            self._innovation = math.nan
            return "missing"
        value = np.asarray(channel.value, dtype=float)
        if value.shape != np.shape(self.limits.noise) or not np.all(np.isfinite(value)):
            self._innovation = math.nan
            return "not finite"
        if last is not None and np.array_equal(last.value, value):
            self._same += dt
            if self._same > self.limits.frozen_after - 0.5 * dt:
                return "frozen"
            if channel.stamp == last.stamp:
                return "spike" if self._innovation > self._gate else ""
        else:
            self._same = 0.0
        error = value - predicted.value
        covariance = predicted.covariance + np.diag(np.square(self.limits.noise))
        if allowed is not None:
            covariance = covariance + np.asarray(allowed)
        self._innovation = float(error @ np.linalg.solve(covariance, error)) / len(error)
        return "spike" if self._innovation > self._gate else ""

    def _stop(self, predicted: Prediction, dt: float) -> str:
        if self._served > self.limits.longest + 0.5 * dt:
            return (
                f"{self.name} {self._fault}: predicted for {self._served:.2f} s, "
                f"the longest is {self.limits.longest:g} s"
            )
        sigma = np.sqrt(np.diag(predicted.covariance))
        over = np.flatnonzero(~(sigma <= self.limits.largest))
        if over.size:
            k = int(over[np.argmax(sigma[over] / np.asarray(self.limits.largest)[over])])
            return (
                f"{self.name} {self._fault}: component {k} predicted to {sigma[k]:.3g}, "
                f"the most is {self.limits.largest[k]:.3g}"
            )
        return ""


@dataclasses.dataclass(frozen=True)
class Sensed:
    """Observation, wrench and tilt that a controller may act on.

    Attributes:
        observation: Observation with wrench and tilt predicted where a sample was rejected; their
            validity is PREDICTED there.
        wrench: Accepted or predicted wrench (6,) with its covariance.
        tilt: Accepted or predicted tilt (2,) with its covariance.
        faults: Why a sample was replaced, by channel.
        failed: Channels whose sensor is failed.
        stop: Why the task cannot go on; empty if it can.
    """

    observation: Observation
    wrench: Prediction
    tilt: Prediction
    faults: Mapping[str, str]
    failed: frozenset[str]
    stop: str


class SurrogateSensing:
    """Checks a robot's observations, and replaces readings that are missing or wrong.

    Args:
        wrench: Model of the wrench under the arm.
        tilt: Model of the base's tilt.
        limits: Limits of ``arm_base_wrench`` and ``inclinometer``.

    Raises:
        ValueError: If limits are missing or unknown.
    """

    def __init__(
        self, wrench: WrenchModel, tilt: TiltModel, limits: Mapping[str, SensorLimits]
    ) -> None:
        if set(limits) != {WRENCH, TILT}:
            raise ValueError(f"limits of {', '.join(limits) or 'nothing'}: need {WRENCH}, {TILT}")
        self._wrench, self._tilt = wrench, tilt
        self._monitors = {name: SensorMonitor(name, limits[name]) for name in (WRENCH, TILT)}
        self.reset()

    def reset(self) -> None:
        """Reset models and monitors; the sensors count as working."""
        self._wrench.reset()
        self._tilt.reset()
        for monitor in self._monitors.values():
            monitor.reset()
        self._level: Channel | None = None
        self._tilt_sigma: FloatArray | None = None
        self._stamp = math.nan

    def step(
        self,
        observation: Observation,
        dt: float,
        contact: bool = False,
        obstacles: bool = False,
    ) -> Sensed:
        """Check an observation, and replace what is wrong in it.

        Args:
            observation: Observation of the robot.
            dt: Time since the observation before [s].
            contact: Whether the hand may touch something: then a wrench that a force at the hand
                explains is no fault, and nothing can predict it. A touch that was not announced
                looks like a failed wrench.
            obstacles: Whether the hand may run into something though it should not: then too such
                a wrench is no fault, for whoever moves the hand must feel it; a wrench that is
                lost is predicted as in free motion.
        """
        for name in ("arm_angles", "arm_rates"):
            channel = getattr(observation, name)
            if not channel.usable or not np.all(np.isfinite(channel.value)):
                return _blind(observation, name)
        # This tick's tilt is not judged yet.
        before = observation._replace(inclinometer=self._level or observation.inclinometer)
        wrench = self._wrench.predict(before, dt, self._tilt_sigma)
        touchable = contact or obstacles
        allowed = self._wrench.contact_covariance(observation) if touchable else None
        if contact and allowed is not None:
            wrench = Prediction(wrench.value, wrench.covariance + allowed)
        felt = self._monitors[WRENCH].step(observation.arm_base_wrench, wrench, dt, allowed)
        mended, expected = observation, wrench
        if felt.believed:
            noise = np.diag(np.square(self._monitors[WRENCH].limits.noise))
            wrench = Prediction(np.asarray(observation.arm_base_wrench.value, dtype=float), noise)
        else:
            mended = mended._replace(arm_base_wrench=_predicted(wrench, observation.time))
        tilt = self._tilt.predict(mended, dt, wrench.covariance)
        seen = self._monitors[TILT].step(observation.inclinometer, tilt, dt)
        if seen.believed:
            if observation.inclinometer.stamp != self._stamp:
                self._tilt.correct(np.asarray(observation.inclinometer.value, dtype=float))
            self._stamp = observation.inclinometer.stamp
            self._tilt_sigma = None
        else:
            if felt.believed and not contact and self._tilt_sigma is not None:
                self._weigh(before, expected, wrench, dt)
            mended = mended._replace(inclinometer=_predicted(tilt, observation.time))
            # The wrench that follows from a predicted tilt is as unsure as that is: else the good
            # wrench sensor would be called failed for the lost inclinometer.
            self._tilt_sigma = np.sqrt(np.diag(tilt.covariance))
        self._level = mended.inclinometer
        verdicts = {WRENCH: felt, TILT: seen}
        return Sensed(
            mended,
            wrench,
            self._tilt.tilt,
            {name: verdict.fault for name, verdict in verdicts.items() if not verdict.believed},
            frozenset(name for name, verdict in verdicts.items() if verdict.failed),
            "; ".join(verdict.stop for verdict in verdicts.values() if verdict.stop),
        )

    def _weigh(
        self, believed: Observation, expected: Prediction, wrench: Prediction, dt: float
    ) -> None:
        """Correct the tilt by the arm's weight."""
        assert self._tilt_sigma is not None
        value, noise = wrench
        off = self._wrench.tilt_error(believed, expected, value, noise, self._tilt_sigma, dt)
        if off is not None:
            tilt = np.asarray(believed.inclinometer.value, dtype=float) + off.value
            self._tilt.weigh(Prediction(tilt, off.covariance))


def _blind(observation: Observation, name: str) -> Sensed:
    """Return that nothing may be acted on: no model replaces the arm's own motion."""
    wrench, tilt = (
        Prediction(np.full(count, np.nan), np.diag(np.full(count, np.inf))) for count in (6, 2)
    )
    reason = f"{name} missing or not finite: nothing predicts it"
    return Sensed(observation, wrench, tilt, {name: "missing"}, frozenset({name}), reason)


def _predicted(prediction: Prediction, time: float) -> Channel:
    value = prediction.value.copy()
    value.flags.writeable = False
    return Channel(value, time, Validity.PREDICTED)
