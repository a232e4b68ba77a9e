"""Zero-moment point, and arm motions that keep it within the footprint.

The zero-moment point (thesis eq. A-5) is where the ground's pressure must act to balance weight,
inertia and outer forces. While it lies within the polygon of the tyres' contacts, no wheel has to
pull, and the rover does not tip. The printed equation treats particles; a link of finite size also
needs the change of its own angular momentum, which enters here as its moment.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from controllers.kinematics.rigid_motion import LEVEL, FrameMotion
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import cross_matrix
from twin.description import RigidBody, RobotDescription

_RAMP = 0.1
"""Time in which the joints' servos bring a steady motion up to its speed [s]. Assumption."""


def zero_moment_point(wrench: ArrayLike, height: float = 0.0) -> FloatArray:
    """Return (2,) x, y where the ground's force needs no moment about x and y [m].

    Args:
        wrench: (6,) force [N] and moment about the origin [N m] by the ground on the robot, in
            axes whose z is the ground's normal.
        height: Height of the ground's plane along z [m].

    Raises:
        ValueError: If the ground would have to pull, or not push at all.
    """
    fx, fy, fz, mx, my, _ = (float(value) for value in np.asarray(wrench, dtype=float))
    if not fz > 0.0:
        raise ValueError(f"ground's normal force {fz} N: a zero-moment point needs a push")
    return np.array([(height * fx - my) / fz, (mx + height * fy) / fz])


def ground_wrench(
    masses: ArrayLike,
    centres: ArrayLike,
    specific_forces: ArrayLike,
    spins: ArrayLike,
    pushes: ArrayLike | None = None,
) -> FloatArray:
    """Return (6,) the ground's force and moment about the origin (eq. A-5's sums) [N, N m].

    Args:
        masses: (n,) of the bodies [kg].
        centres: (n, 3) centres of mass [m].
        specific_forces: (n, 3) their accelerations minus that of free fall [m/s^2].
        spins: (n, 3) change of each body's angular momentum about its centre [N m].
        pushes: (k, 9) force [N], moment [N m] and point [m] of what else acts on the robot.
    """
    forces = np.asarray(masses, dtype=float)[:, None] * np.asarray(specific_forces, dtype=float)
    moments = np.cross(np.asarray(centres, dtype=float), forces) + np.asarray(spins, dtype=float)
    total = np.concatenate([forces.sum(axis=0), moments.sum(axis=0)])
    for push in np.empty((0, 9)) if pushes is None else np.asarray(pushes, dtype=float):
        total -= np.concatenate([push[:3], push[3:6] + np.cross(push[6:], push[:3])])
    return total


@dataclasses.dataclass(frozen=True)
class Footing:
    """A rover as one rigid body on its wheels, with its arm, in the body frame.

    Attributes:
        base: The rover without its arm.
        chain: The arm, with what it carries.
        mount: (3,) foot of the arm [m].
        polygon: (k, 2) x, y of the tyres' contacts, counter-clockwise [m].
        ground: Height of the ground [m], below the origin.
    """

    base: RigidBody
    chain: SerialChain
    mount: FloatArray
    polygon: FloatArray
    ground: float

    @classmethod
    def of(cls, robot: RobotDescription) -> "Footing":
        """Return the footing of a rover with an arm, as drawn.

        Args:
            robot: Description of the rover.
        """
        assert robot.arm is not None
        x, y = robot.half_track, robot.half_wheelbase
        polygon = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
        mount = np.asarray(robot.arm.transform_base_to_robot.translation)
        arm = SerialChain.of_robot(robot)
        return cls(robot.body, arm, mount, polygon, -robot.centre_height)

    def zero_moment_point(
        self,
        angles: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        motion: FrameMotion = LEVEL,
    ) -> FloatArray:
        """Return (2,) x, y of the zero-moment point [m], body frame; arguments as `wrench`.

        Raises:
            ValueError: If the rover would leave the ground.
        """
        wrench = self.wrench(angles, rates, accelerations, motion)
        return zero_moment_point(wrench, self.ground)

    def wrench(
        self,
        angles: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        motion: FrameMotion = LEVEL,
    ) -> FloatArray:
        """Return (6,) the ground's force [N] and moment about the origin [N m], body frame.

        Args:
            angles: (n,) joint angles of the arm [rad].
            rates: (n,) joint rates [rad/s].
            accelerations: (n,) joint accelerations [rad/s^2].
            motion: Motion of the base, at the body frame's origin.
        """
        foot = motion.at(self.mount)
        arm = self.chain.inverse_dynamics(angles, rates, accelerations, foot)[1]
        force = self.base.mass * motion.at(self.base.centre).specific_force
        turning = cross_matrix(motion.angular_velocity)
        spin = self.base.inertia @ motion.angular_acceleration
        spin += turning @ self.base.inertia @ motion.angular_velocity
        levered = cross_matrix(self.base.centre) @ force + cross_matrix(self.mount) @ arm[:3]
        moment = spin + levered + arm[3:]
        return np.concatenate([force + arm[:3], moment])

    def margin(self, point: ArrayLike) -> float:
        """Return how far a point is inside the polygon; negative outside [m].

        Args:
            point: (2,) x, y [m], body frame.
        """
        start, end = self.polygon, np.roll(self.polygon, -1, axis=0)
        along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
        rel = np.asarray(point, dtype=float) - start
        return float(np.min(along[:, 0] * rel[:, 1] - along[:, 1] * rel[:, 0]))


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A straight motion of the joints from rest to rest, quintic in time.

    Attributes:
        start: (n,) [rad].
        end: (n,) [rad].
        duration: [s].
        part: Part of the path from start to end that is travelled, (0, 1].
    """

    start: FloatArray
    end: FloatArray
    duration: float
    part: float = 1.0

    def at(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angles [rad], rates [rad/s] and accelerations [rad/s^2].

        Args:
            time: Time since the start [s]; the joints rest before and after.
        """
        t = min(max(time / self.duration, 0.0), 1.0)
        distance = (self.end - self.start) * self.part
        rate = 30.0 * t**2 * (1.0 - t) ** 2 / self.duration
        bend = 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / self.duration**2
        gone = t**3 * (10.0 + t * (6.0 * t - 15.0))
        return self.start + gone * distance, rate * distance, bend * distance


@dataclasses.dataclass(frozen=True)
class SteadySweep(Sweep):
    """A straight motion of the joints from rest to rest at a steady speed, between short ramps."""

    def at(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angles [rad], rates [rad/s] and accelerations [rad/s^2].

        Args:
            time: Time since the start [s]; the joints rest before and after.
        """
        gone = min(max(time, 0.0), self.duration)
        distance = (self.end - self.start) * self.part
        rate, ramp = distance / self.duration, min(_RAMP, 0.5 * self.duration)
        left = self.duration - gone
        bend = float(gone < ramp) - float(left < ramp)
        share = min(gone / ramp, left / ramp, 1.0)
        return self.start + gone / self.duration * distance, share * rate, bend / ramp * rate


@dataclasses.dataclass(frozen=True)
class GuardConfig:
    """Reserve and sampling of the guard.

    Attributes:
        reserve: Least distance of the zero-moment point from the polygon's edge [m]: it carries
            what the estimate lacks, as the base's own swing and the payload's error.
        samples: Number of samples of a motion that are checked.
        slowest: Largest stretch of a motion's duration; a motion that needs more is cut short.
    """

    reserve: float = 0.03
    samples: int = 41
    slowest: float = 10.0


@dataclasses.dataclass(frozen=True)
class Guarded:
    """Motion as the guard allows it.

    Attributes:
        sweep: The motion, slowed or cut short; None if the arm must stay.
        stretch: Duration over the requested one, for the same part of the path.
        margin: Least margin of the requested motion [m]; negative where it would tip.
        report: Intervention and its reason; empty if there was none.
    """

    sweep: Sweep | None
    stretch: float
    margin: float
    report: str


def guard(
    footing: Footing, sweep: Sweep, still: FrameMotion = LEVEL, config: GuardConfig | None = None
) -> Guarded:
    """Slow a motion until its zero-moment point stays within the footprint, or cut it short.

    Args:
        footing: The rover.
        sweep: Requested motion.
        still: The base at rest, as its inclinometer has it.
        config: Reserve and sampling; None for the default.

    Raises:
        ValueError: If the motion is not one of the arm's joints, or not finite.
    """
    rules = config or GuardConfig()
    asked = least_margin(footing, sweep, still, rules.samples)
    if asked >= rules.reserve:
        return Guarded(sweep, 1.0, asked, "")
    part = _stable_part(footing, sweep, still, rules)
    if part <= 0.0:
        return Guarded(None, 1.0, asked, "refused: the arm's pose is at the edge of tipping as is")
    base = dataclasses.replace(sweep, part=sweep.part * part)

    def stretched(factor: float) -> Sweep:
        return dataclasses.replace(base, duration=sweep.duration * factor)

    low, high = 0.0, 1.0
    while least_margin(footing, stretched(high), still, rules.samples) < rules.reserve:
        low, high = high, 1.5 * high
        if high > rules.slowest:
            return Guarded(None, 1.0, asked, "refused: no speed keeps the rover on its wheels")
    for _ in range(12 if low > 0.0 else 0):
        middle = 0.5 * (low + high)
        inside = least_margin(footing, stretched(middle), still, rules.samples) >= rules.reserve
        low, high = (low, middle) if inside else (middle, high)
    cut = f", cut to {part:.0%} of the path" if part < 1.0 else ""
    report = f"zero-moment point {1e3 * asked:.0f} mm inside: slowed {high:.2f} times{cut}"
    return Guarded(stretched(high), high, asked, report)


def least_margin(footing: Footing, sweep: Sweep, still: FrameMotion, samples: int) -> float:
    """Return the zero-moment point's least distance inside the polygon over a motion [m].

    Minus infinity if the rover would leave the ground.

    Args:
        footing: The rover.
        sweep: The motion.
        still: The base at rest.
        samples: Number of samples of the motion that are checked.

    Raises:
        ValueError: If the motion is not one of the arm's joints, or not finite.
    """
    margins: list[float] = []
    for time in np.linspace(0.0, sweep.duration, samples):
        wrench = footing.wrench(*sweep.at(time), still)
        if not wrench[2] > 0.0:
            return -np.inf
        margins.append(footing.margin(zero_moment_point(wrench, footing.ground)))
    return min(margins)


def _stable_part(footing: Footing, sweep: Sweep, still: FrameMotion, rules: GuardConfig) -> float:
    """Return the part of the path, in [0, 1], along which the arm could rest at every point.

    A tenth of the reserve is left to the motion, so that a slow one fits in.
    """
    zero = np.zeros(len(sweep.start))
    part = 0.0
    for gone in np.linspace(0.0, 1.0, rules.samples):
        angles = sweep.start + gone * sweep.part * (sweep.end - sweep.start)
        point = footing.zero_moment_point(angles, zero, zero, still)
        if footing.margin(point) < 1.1 * rules.reserve:
            break
        part = float(gone)
    return part
