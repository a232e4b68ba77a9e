"""Measurements of an arm's identification: the log of a run, and joint and base motion from it.

Rates and accelerations are plain central differences of what was measured, which distort nothing.
Their noise is large, but the equations of motion are linear in the accelerations: so the noise is
taken out afterwards, by one filter that goes over both sides of the equation, measured wrench and
predicted wrench alike, and biases neither.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from controllers.kinematics.rigid_motion import FrameMotion
from perception.geometry.arrays import FloatArray
from twin.robot import Observation


class IdentificationError(ValueError):
    """The measurements do not allow the requested estimate."""


class ObservationLog:
    """Log of the channels that an estimate needs, tick by tick.

    Args:
        purpose: Use of the channels; begins every error.
        channels: Names of fields of `Observation`.
    """

    def __init__(self, purpose: str, channels: Sequence[str]) -> None:
        self._purpose = purpose
        self._channels = tuple(channels)
        self._times: list[float] = []
        self._values: dict[str, list[FloatArray]] = {name: [] for name in channels}
        self._stamps: dict[str, list[float]] = {name: [] for name in channels}

    def forget_before(self, time: float) -> None:
        """Discard the ticks before a time [s]."""
        first = int(np.searchsorted(self._times, time))
        del self._times[:first]
        for rows in (*self._values.values(), *self._stamps.values()):
            del rows[:first]

    def __len__(self) -> int:
        return len(self._times)

    @property
    def times(self) -> FloatArray:
        """Robot time of each tick (n,) [s]."""
        return np.array(self._times)

    def take(self, observation: Observation) -> None:
        """Store one tick.

        Raises:
            IdentificationError: If a channel is missing or stale, or holds a NaN or an infinity.
        """
        for name in self._channels:
            channel = getattr(observation, name)
            if not channel.usable:
                raise IdentificationError(
                    f"{self._purpose} needs {name}, which is {channel.validity.value} "
                    f"at {observation.time:.3f} s"
                )
            value = np.asarray(channel.value, dtype=float)
            bad = np.flatnonzero(~np.isfinite(value))
            if bad.size:
                raise IdentificationError(
                    f"{self._purpose}: {name}[{bad[0]}] is {value[bad[0]]} "
                    f"at {observation.time:.3f} s"
                )
            self._values[name].append(value)
            self._stamps[name].append(channel.stamp)
        self._times.append(observation.time)

    def values(self, channel: str) -> FloatArray:
        """Return what a channel read at every tick, (n, width)."""
        return np.array(self._values[channel])

    def age(self, channel: str) -> float:
        """Return how old a channel typically was at its tick [s]."""
        return float(np.median(self.times - np.array(self._stamps[channel])))

    def samples(self, channel: str) -> tuple[FloatArray, FloatArray]:
        """Return a channel's samples, each once: time stamps (m,) [s] and values (m, width)."""
        stamps, first = np.unique(self._stamps[channel], return_index=True)
        return stamps, self.values(channel)[first]


CHANNELS = ("arm_angles", "inclinometer", "arm_base_wrench")
SHORTEST = 60
"""Least number of ticks of a run."""


@dataclasses.dataclass(frozen=True)
class SensingConfig:
    """Interpretation of the measured signals.

    Attributes:
        gravity: [m/s^2].
        lever: (3,) from the point about which the base tilts to the arm's base frame [m].
        inclinometer_bandwidth: First-order corner of the tilt sensor, undone here [Hz].
        tilt_motion: Whether the tilt gives the base's accelerations too, and not only the
            direction of gravity.
    """

    gravity: float = 9.81
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inclinometer_bandwidth: float = 6.0
    tilt_motion: bool = True


@dataclasses.dataclass(frozen=True)
class ArmRecord:
    """A run of the arm as one consistent set of samples, at the wrench's time stamps.

    Attributes:
        times: (n,) [s].
        angles: (n, joints) joint angles [rad].
        rates: (n, joints) [rad/s].
        accelerations: (n, joints) [rad/s^2].
        base: Motion of the arm's base frame: tilt only, the base does not travel.
        wrench: (n, 6) force [N] and moment [N m] by the rover on the arm.
    """

    times: FloatArray
    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    base: FrameMotion
    wrench: FloatArray


def read_arm(log: ObservationLog, config: SensingConfig) -> ArmRecord:
    """Return the motion of arm and base in a run, and the wrench between them.

    Args:
        log: Log of the run, with `CHANNELS`.
        config: Interpretation of the measured signals.

    Raises:
        IdentificationError: If the run is too short or its ticks are not even.
    """
    times = log.times
    if len(times) < SHORTEST:
        raise IdentificationError(
            f"a run of {len(times)} ticks is too short; at least {SHORTEST} are needed"
        )
    if np.ptp(np.diff(times)) > 0.1 * np.median(np.diff(times)):
        raise IdentificationError("the ticks of the run are not even; resample it first")
    stamps = times - log.age("arm_base_wrench")
    seen = times - log.age("arm_angles")
    measured = _differentiate(log.values("arm_angles"), seen)
    angles, rates, accelerations = _at(stamps, seen, *measured)
    base = _base_motion(log, config, stamps)
    return ArmRecord(stamps, angles, rates, accelerations, base, log.values("arm_base_wrench"))


def filter_alike(values: FloatArray, window: int, stride: int = 1) -> FloatArray:
    """Return weighted means under a raised cosine, where it fits in whole.

    Args:
        values: (n, ...) samples.
        window: Ticks under the cosine, odd.
        stride: Ticks from one mean to the next.
    """
    flat = values.reshape(len(values), -1)
    means = sliding_window_view(flat, window, axis=0)[::stride] @ raised_cosine(window)
    return means.reshape(len(means), *values.shape[1:])


def raised_cosine(window: int) -> FloatArray:
    """Return the weights (window,) of `filter_alike`; their sum is one."""
    weights = 1.0 - np.cos(2.0 * np.pi * np.arange(1, window + 1) / (window + 1))
    return weights / weights.sum()


def weighed(values: FloatArray, window: int, noise: ArrayLike) -> FloatArray:
    """Return (6 m, k) of wrenches (n, 6, k): filtered, over the deviation of the filtered noise.

    Args:
        values: Samples.
        window: Ticks under the filter, odd; one equation each half window.
        noise: (6,) standard deviation of a sample [N, N m].
    """
    gain = float(np.sum(raised_cosine(window) ** 2))
    sigma = np.asarray(noise, dtype=float) * np.sqrt(gain)
    filtered = filter_alike(values, window, (window + 1) // 2) / sigma[:, None]
    return filtered.reshape(6 * len(filtered), values.shape[-1])


def _differentiate(
    values: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, rates and accelerations, by central differences on an even grid."""
    period = (times[-1] - times[0]) / (len(times) - 1)
    rates = np.gradient(values, period, axis=0)
    inner = np.diff(values, 2, axis=0) / period**2
    return values, rates, np.concatenate([inner[:1], inner, inner[-1:]])


def _at(times: FloatArray, stamps: FloatArray, *series: FloatArray) -> list[FloatArray]:
    """Return series (n, width) that are known at some stamps as they are at some times."""
    return [np.stack([np.interp(times, stamps, row) for row in one.T], axis=1) for one in series]


def _base_motion(log: ObservationLog, config: SensingConfig, times: FloatArray) -> FrameMotion:
    """Return the base's tilting motion at some times; heading and position are assumed fixed."""
    stamps, seen = log.samples("inclinometer")
    if len(stamps) < SHORTEST // 4:
        raise IdentificationError(
            f"only {len(stamps)} samples of the inclinometer; {SHORTEST // 4} are needed"
        )
    even = np.linspace(stamps[0], stamps[-1], len(stamps))
    lag = 1.0 / (2.0 * np.pi * config.inclinometer_bandwidth)
    slow = _at(even, stamps, seen)[0]
    undone = slow + lag * np.gradient(slow, even[1] - even[0], axis=0)
    tilt, rate, acceleration = _at(times, even, *_differentiate(undone, even))
    pitch, roll = tilt.T
    still = np.zeros_like(pitch)
    up = np.stack([-np.sin(roll) * np.cos(pitch), np.sin(pitch), np.cos(roll) * np.cos(pitch)], 1)
    if not config.tilt_motion:
        nothing = np.zeros_like(up)
        return FrameMotion(config.gravity * up, nothing, nothing)
    omega = np.stack([rate[:, 0], rate[:, 1], still], axis=1)
    alpha = np.stack([acceleration[:, 0], acceleration[:, 1], still], axis=1)
    # Products of rates are left out: at a tilt of a few degrees they are below their own noise.
    moving = np.cross(alpha, np.asarray(config.lever))
    return FrameMotion(config.gravity * up + moving, omega, alpha)
