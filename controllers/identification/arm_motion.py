"""How the arm swings: rod geometry of the three modes, and excitation within the arm's limits."""

import dataclasses
from typing import NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_choice

MODES = ("x", "y", "z")


@dataclasses.dataclass(frozen=True)
class RigidArm:
    """The arm as one known rigid body on the mount (Thesis section 2.6.1).

    Attributes:
        mass: [kg].
        inertia: (3,) principal moments about its centre [kg m^2], rod along y at angle zero.
        centre: Distance of its centre from the mount, along the rod [m].
    """

    mass: float = 1.0
    inertia: tuple[float, float, float] = (0.02, 0.001, 0.02)
    centre: float = 0.245


@dataclasses.dataclass(frozen=True)
class ArmLimits:
    """What the arm can do.

    Attributes:
        amplitude: Least and greatest amplitude of the excitation [rad].
        offset: Least and greatest offset [rad].
        frequency: Least and greatest angular frequency [rad/s].
        rate: Greatest joint rate [rad/s].
        acceleration: Greatest joint acceleration [rad/s^2]: the torque limit on a known arm.
        bandwidth: Triple pole of the target filter [rad/s].
    """

    amplitude: tuple[float, float] = (0.05, 0.9)
    offset: tuple[float, float] = (0.0, np.pi / 2)
    frequency: tuple[float, float] = (0.5, 30.0)
    rate: float = 5.0
    acceleration: float = 100.0
    bandwidth: float = 20.0

    def bounds(self) -> FloatArray:
        """Return (3, 2) bounds of (offset, amplitude, frequency)."""
        return np.array([self.offset, self.amplitude, self.frequency])


class Excitation(NamedTuple):
    """f(t) = offset + amplitude sin(phase), the phase running at `frequency` (Thesis eq. B-1).

    Attributes:
        offset: a0 [rad].
        amplitude: a [rad].
        frequency: omega [rad/s].
    """

    offset: float
    amplitude: float
    frequency: float


CONSTANT = Excitation(np.pi / 4, 2 * np.pi / 9, np.pi / 2)
"""The constant-parameter excitation, Thesis eq. 2-21."""


class Trajectory(NamedTuple):
    """Arm angle over a window, piecewise cubic: the jerk is constant over each step.

    Attributes:
        time_step: [s].
        angle: (n + 1,) [rad] at the steps' ends, the first being the window's start.
        rate: (n + 1,) [rad/s].
        acceleration: (n + 1,) [rad/s^2].
        jerk: (n,) [rad/s^3].
    """

    time_step: float
    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    def then(self, other: "Trajectory") -> "Trajectory":
        """Return this window followed by `other`, which starts where this one ends."""
        return Trajectory(
            self.time_step,
            np.concatenate([self.angle, other.angle[1:]]),
            np.concatenate([self.rate, other.rate[1:]]),
            np.concatenate([self.acceleration, other.acceleration[1:]]),
            np.concatenate([self.jerk, other.jerk]),
        )


class ArmState(NamedTuple):
    """Where one arm axis is between two windows.

    Attributes:
        angle: [rad].
        rate: [rad/s].
        acceleration: [rad/s^2].
        phase: Phase of the excitation's sine [rad].
    """

    angle: float = np.pi / 4
    rate: float = 0.0
    acceleration: float = 0.0
    phase: float = 0.0


def swing(
    state: ArmState, excitation: Excitation, limits: ArmLimits, steps: int, time_step: float
) -> tuple[Trajectory, ArmState]:
    """Follow an excitation from `state`, smoothly and within the limits, transitions included.

    A cascade of position, rate and acceleration loops: with no limit active it is a triple pole
    at `limits.bandwidth`; its set-points are clipped, so that a planner cannot gain from a jump.

    Args:
        state: Start.
        excitation: Excitation to follow.
        limits: The arm's limits.
        steps: Number of steps.
        time_step: [s].

    Returns:
        The trajectory, and the state at its end.
    """
    rows, end = _follow(
        state,
        excitation,
        (limits.bandwidth, limits.rate, limits.acceleration),
        steps,
        time_step,
    )
    angle, rate, acceleration, jerk = np.ascontiguousarray(rows.T)
    trajectory = Trajectory(time_step, angle, rate, acceleration, jerk[:-1])
    return trajectory, ArmState(*end)


@numba.njit(cache=True)
def _follow(state, excitation, limits, steps, time_step):
    """Return angle, rate, acceleration and jerk (steps + 1, 4), and the end state."""
    angle, rate, acceleration, phase = state
    offset, amplitude, frequency = excitation
    bandwidth, rate_limit, acceleration_limit = limits
    # The rate loop overshoots by less than 2 %: aim below the limit by as much.
    set_point = 0.98 * rate_limit
    rows = np.empty((steps + 1, 4))
    for step in range(steps + 1):
        target = offset + amplitude * np.sin(phase)
        wanted_rate = min(max(bandwidth / 3 * (target - angle), -set_point), set_point)
        wanted = bandwidth * (wanted_rate - rate)
        wanted = min(max(wanted, -acceleration_limit), acceleration_limit)
        jerk = 3 * bandwidth * (wanted - acceleration)
        rows[step] = np.array([angle, rate, acceleration, jerk])
        if step < steps:
            angle += time_step * (rate + time_step * (acceleration / 2 + time_step * jerk / 6))
            rate += time_step * (acceleration + time_step * jerk / 2)
            acceleration += time_step * jerk
            phase += time_step * frequency
    return rows, (angle, rate, acceleration, phase % (2 * np.pi))


def mode_axes(mode: str) -> tuple[FloatArray, FloatArray]:
    """Return how one of the three modes holds and turns the rod, in the base frame.

    Mode x elevates the rod, which points forward, about x; mode y turns it to the right by the
    base joint first and elevates it about -y; mode z yaws it.

    Args:
        mode: One of `MODES`.

    Returns:
        Unit axis of rotation (3,), and rotation (3, 3) of the arm at angle zero.

    Raises:
        ValueError: If there is no such mode.
    """
    check_choice("mode", mode, MODES)
    axis = np.array({"x": [1.0, 0.0, 0.0], "y": [0.0, -1.0, 0.0], "z": [0.0, 0.0, 1.0]}[mode])
    aside = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return axis, aside if mode == "y" else np.eye(3)
