"""What a planned motion may lead to: an ensemble of rovers that differ as the real one may.

Each copy has masses, centres, springs, tyres and a slope as likely as what is known of them, and
does what is planned in a reduced model (`rocking`). The share of copies that tip over, slide, touch
the ground with the arm or ask too much of a motor is the probability that the rover will. A guard
that asks whether the zero-moment point leaves the footprint (`tip_over`) is stricter: a rover may
rock and come back.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import scipy.interpolate
import scipy.signal
from numpy.typing import NDArray

from controllers.kinematics.rigid_motion import LEVEL, WEIGHTLESS, FrameMotion
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.tipping.rocking import Chassis, Copies, Moving, rock
from controllers.motion.tipping.tip_over import Guarded, Sweep
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from perception.geometry.gravity import GRAVITY
from twin.description import RigidBody, RobotDescription

PERIOD = 0.01
"""Time between two samples of a plan [s]."""
TIPPED = math.radians(10.0)
"""Tilt from the ground's normal from which on a rover counts as tipped over."""
CENTRE_RANGE = math.radians(30.0)
"""How far the centre joint turns to either side. Assumption, as in the drawing."""
CHANCE = 0.05
"""Largest probability to tip over that a guard allows."""
_SLOWER, _SLOWEST = 1.25, 10.0  # Stretch of a motion from one try to the next, and the last.
_AFTER = 1.0  # Time for which a base swings on after a motion [s].
_LAG = 0.05  # Time constant with which the wheels follow their commanded speed [s].
_SLIDING = 0.999  # Share of all friction at once from which on a rover slides.
_LEAST = 0.2  # Least share of a spring or damper that a copy may have.
_FREE = FrameMotion(np.zeros(3), np.zeros(3), np.zeros(3))


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a rover is about to do, every `PERIOD` from now on.

    Attributes:
        angles: (n, joints) of the arm [rad].
        rates: (n, joints) [rad/s].
        accelerations: (n, joints) [rad/s^2].
        rims: (n, 2) speed of the rims of the left and of the right tyres [m/s].
        speed: Forward speed of the rover now [m/s].
        turn: Its turning rate to the left now [rad/s].
    """

    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    rims: FloatArray
    speed: float = 0.0
    turn: float = 0.0

    @classmethod
    def of_arm(
        cls, path: Callable[[float], tuple[FloatArray, FloatArray, FloatArray]], seconds: float
    ) -> "Plan":
        """Return a motion of the arm while the wheels stand.

        Args:
            path: Function that gives angles, rates and accelerations at a time [s].
            seconds: How far to look [s].
        """
        count = round(seconds / PERIOD)
        rows = [path(index * PERIOD) for index in range(count)]
        angles, rates, accelerations = (np.array(row) for row in zip(*rows))
        return cls(angles, rates, accelerations, np.zeros((count, 2)))

    @classmethod
    def of_table(cls, stamps: FloatArray, angles: FloatArray) -> "Plan":
        """Return a motion of the arm from rest, and the second after it, while the wheels stand.

        Args:
            stamps: (n,) times, rising [s].
            angles: (n, joints) of the arm [rad].
        """
        spline = scipy.interpolate.CubicSpline(stamps, angles, bc_type="clamped")
        first, last = stamps[0], stamps[-1]

        def path(time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
            if first + time >= last:
                return angles[-1], np.zeros(angles.shape[1]), np.zeros(angles.shape[1])
            return spline(first + time), spline(first + time, 1), spline(first + time, 2)

        return cls.of_arm(path, float(last - first) + _AFTER)

    @classmethod
    def of_drive(
        cls, angles: FloatArray, commanded: FloatArray, now: FloatArray | None = None,
        turn: float = 0.0,
    ) -> "Plan":  # fmt: skip
        """Return a drive with the arm at rest.

        Args:
            angles: (joints,) of the arm [rad].
            commanded: (n, 2) speed of the rims of the left and of the right tyres [m/s].
            now: (2,) that they have [m/s]; None for none.
            turn: Turning rate to the left that the rover has [rad/s].
        """
        held = np.tile(angles, (len(commanded), 1))
        rest, begin = np.zeros_like(held), np.zeros(2) if now is None else now
        return cls(held, rest, rest, _followed(commanded, begin), float(np.mean(begin)), turn)


@dataclasses.dataclass(frozen=True)
class Doubt:
    """What is not known of a rover; the default is for one as made.

    Attributes:
        mass: Standard deviation of the masses of rover and arm, as a share of each.
        centre: Standard deviation along each axis of the rover's centre of mass without its arm
            [m].
        spring: Standard deviation of each spring's stiffness, as a share of it.
        damper: Standard deviation of each damper, as a share of it.
        load: Standard deviation of the mass in the gripper, as a share of it.
        tilt: Standard deviation of the measured tilt about each axis [rad].
    """

    mass: float = 0.03
    centre: float = 0.006
    spring: float = 0.17
    damper: float = 0.17
    load: float = 0.03
    tilt: float = 0.003

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        check_numbers("doubt", self, zero=True)


@dataclasses.dataclass(frozen=True)
class Outlook:
    """What became of the copies.

    Attributes:
        tips: (n,) time at which each has tipped over [s]; infinite for never.
        slides: (n,) time from which each would need more friction than there is [s], likewise.
        strains: (n,) time from which each would need more than the arm's motors give [s], likewise.
        touches: (n,) time at which a sphere that covers the arm of each reaches the ground [s],
            likewise.
        tilts: (n, times) tilt of each from the ground's normal [rad].
    """

    tips: FloatArray
    slides: FloatArray
    strains: FloatArray
    touches: FloatArray
    tilts: FloatArray

    def tip(self, within: float = math.inf) -> float:
        """Return the probability that the rover tips over within a time [s]."""
        return float(np.mean(self.tips < within))

    def slide(self, within: float = math.inf) -> float:
        """Return the probability that it slides within a time [s]."""
        return float(np.mean(self.slides < within))

    def strain(self, within: float = math.inf) -> float:
        """Return the probability that a motor of the arm cannot follow within a time [s]."""
        return float(np.mean(self.strains < within))

    def touch(self, within: float = math.inf) -> float:
        """Return the probability that the arm touches the ground within a time [s]."""
        return float(np.mean(self.touches < within))


class LookAhead:
    """Looks ahead for one rover.

    Args:
        robot: The rover as drawn, with an arm, and four wheels on springs: front left and right,
            rear left and right.
        load: Mass in the gripper that the drawing does not have [kg].
        place: (3,) its centre in the frame of the last link [m].
        friction: Least and largest Coulomb coefficient that its tyres may well have.
        doubt: What else is not known of it; None for the default.
        copies: Count of copies.
        centre_range: How far its centre joint turns to either side [rad]; 0 if it is locked.

    Raises:
        ValueError: If the rover has no arm, or not four wheels on springs.
    """

    def __init__(
        self,
        robot: RobotDescription,
        load: float = 0.0,
        place: FloatArray | None = None,
        friction: tuple[float, float] = (0.3, 0.8),
        doubt: Doubt | None = None,
        copies: int = 50,
        centre_range: float = CENTRE_RANGE,
    ) -> None:
        springs = np.array([wheel.spring for wheel in robot.wheels])
        if len(springs) != 4 or not np.isfinite(springs).all():  # noqa: PLR2004
            raise ValueError(
                f"{robot.name} has {np.isfinite(springs).sum()} wheels on springs: looking ahead "
                "needs 4"
            )
        self._robot, self._load, self._friction = robot, load, friction
        self._doubt, self._count = doubt or Doubt(), copies
        self._chain = SerialChain.of_robot(robot)
        self._held = _holding(self._chain, np.zeros(3) if place is None else place)
        self._chassis = Chassis(
            np.array([wheel.centre[:2] for wheel in robot.wheels]),
            np.full(4, robot.body.mass * GRAVITY / springs.sum()),
            robot.centre_height,
            centre_range,
        )
        self._centre = np.array([0.0, 0.0, robot.centre_height])
        mount = np.asarray(self._chain.transform_base_to_robot.translation)
        self._mount = mount + self._centre

    def outlook(self, plan: Plan, rng: np.random.Generator, still: FrameMotion = LEVEL) -> Outlook:
        """Return what a plan may lead to.

        Args:
            plan: What is planned; the base does not swing at its beginning.
            rng: Random generator of the copies.
            still: The base at rest, as its inclinometer has it.
        """
        copies = self._copies(rng, np.asarray(still.specific_force, dtype=float) / GRAVITY)
        places, forces = rock(self._chassis, copies, self._moving(plan))
        level = np.cos(places[:, :, 1]) * np.cos(places[:, :, 2])
        tilts = np.arccos(level)
        over = np.logical_or.accumulate(tilts > TIPPED, axis=1)
        across = np.linalg.norm(forces[:, :, :2], axis=2)
        pressed = forces[:, :, 2]
        slipping = (pressed > 0.0) & (across > _SLIDING * copies.grips[:, None] * pressed)
        strained = self._strained(plan, copies, still)
        touching = self._touching(plan, places) & ~over
        slides = _first(slipping & ~over)
        return Outlook(_first(over), slides, _first(strained), _first(touching), tilts)

    def _copies(self, rng: np.random.Generator, up: FloatArray) -> Copies:
        """Return copies as likely as what is known."""
        doubt, count, robot = self._doubt, self._count, self._robot
        body = robot.body
        masses = body.mass * (1.0 + doubt.mass * rng.standard_normal(count))
        centres = body.centre + self._centre + doubt.centre * rng.standard_normal((count, 3))
        own = np.diag(body.inertia) / body.mass
        apart = np.sum(centres**2, axis=1, keepdims=True) - centres**2
        ups = np.tile(up, (count, 1))
        ups[:, :2] += doubt.tilt * rng.standard_normal((count, 2))
        springs, dampers = (
            np.array([getattr(wheel, name) for wheel in robot.wheels])
            * np.maximum(_LEAST, 1.0 + getattr(doubt, name) * rng.standard_normal((count, 4)))
            for name in ("spring", "damper")
        )
        return Copies(
            ups / np.linalg.norm(ups, axis=1, keepdims=True),
            masses,
            masses[:, None] * centres,
            masses[:, None] * (own + apart),
            1.0 + doubt.mass * rng.standard_normal(count),
            self._load * (1.0 + doubt.load * rng.standard_normal(count)),
            springs,
            dampers,
            rng.uniform(*self._friction, count),
        )

    def _moving(self, plan: Plan) -> Moving:
        """Return a plan as the reduced model takes it."""
        arm, load = (self._about_ground(chain, plan) for chain in (self._chain, self._held))
        return Moving(arm, load, plan.rims, plan.speed, plan.turn, PERIOD)

    def _about_ground(self, chain: SerialChain, plan: Plan) -> FloatArray:
        """Return (n, 34) inertia and wrenches of a chain, as `Moving` has them."""
        r = self._mount
        inertia = chain.base_inertia(plan.angles)
        mass, crosses, about = inertia[:, 0, 0], inertia[:, 3:, :3], inertia[:, 3:, 3:]
        moment = np.stack([crosses[:, 2, 1], crosses[:, 0, 2], crosses[:, 1, 0]], axis=1)
        # From the arm's foot to the ground.
        about = about + (2.0 * moment @ r + mass * (r @ r))[:, None, None] * np.eye(3)
        about -= moment[:, :, None] * r + r[:, None] * moment[:, None]
        about -= mass[:, None, None] * np.outer(r, r)
        moment = moment + mass[:, None] * r
        rest = np.zeros_like(plan.rates)

        def wrench(rates: FloatArray, accelerations: FloatArray, base: FrameMotion) -> FloatArray:
            found = chain.inverse_dynamics(plan.angles, rates, accelerations, base)[1]
            found[:, 3:] += np.cross(r, found[:, :3])
            return found

        wrenches = [wrench(plan.rates, plan.accelerations, _FREE)]
        moved = wrench(plan.rates, rest, _FREE)
        for axis in np.eye(3):
            tilting = FrameMotion(np.cross(axis, np.cross(axis, r)), axis, np.zeros(3))
            both, alone = wrench(plan.rates, rest, tilting), wrench(rest, rest, tilting)
            wrenches.append(both - alone - moved)
        pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        elements = [about[:, row, column] for row, column in pairs]
        return np.column_stack([mass, moment, *elements, *wrenches])

    def _touching(self, plan: Plan, places: FloatArray) -> NDArray[np.bool_]:
        """Return (n, times) whether the arm of a copy is close to the ground."""
        points = self._chain.cover_points(plan.angles) + self._centre
        heave, pitch, roll = np.moveaxis(places[:, :, None, :3], -1, 0)
        x, y, z = np.moveaxis(points, -1, 0)
        # The front half's pitch and roll, of the ground's axes.
        height = heave + np.sin(pitch) * y + np.cos(pitch) * (np.cos(roll) * z - np.sin(roll) * x)
        return height.min(axis=2) < self._chain.cover_radius

    def _strained(self, plan: Plan, copies: Copies, still: FrameMotion) -> NDArray[np.bool_]:
        """Return (n, times) whether a copy needs more than a motor gives."""
        given = plan.angles, plan.rates, plan.accelerations
        own, held = (each.inverse_dynamics(*given, still)[0] for each in (self._chain, self._held))
        needed = copies.arms[:, None, None] * own + copies.loads[:, None, None] * held
        motors = self._robot.motors[len(self._robot.wheels) :]
        most = np.array([motor.stall_torque for motor in motors])
        speeds = np.array([motor.no_load_speed for motor in motors])
        # A motor gives less the faster it turns the way it pushes.
        line = most * (1.0 - np.sign(needed) * plan.rates / speeds)
        return np.any(np.abs(needed) > np.clip(line, 0.0, most), axis=2)


def slow(
    ahead: LookAhead, sweep: Sweep, rng: np.random.Generator, still: FrameMotion = LEVEL
) -> Guarded:
    """Slow a motion as a whole until it hardly tips the rover over, with `CHANCE` at most.

    Args:
        ahead: Looks ahead for the rover.
        sweep: Requested motion, from rest.
        rng: Random generator of the copies.
        still: The base at rest, as its inclinometer has it.

    Returns:
        The motion as it may be made, without a margin; None for its sweep if no speed will do.
    """
    stretch, asked = 1.0, math.nan
    while stretch <= _SLOWEST:
        tried = dataclasses.replace(sweep, duration=stretch * sweep.duration)
        found = ahead.outlook(Plan.of_arm(tried.at, tried.duration + _AFTER), rng, still).tip()
        if found <= CHANCE:
            told = (
                f"tips over with {asked:.0%}: slowed {stretch:.2f} times" if stretch > 1.0 else ""
            )
            return Guarded(tried, stretch, math.nan, told)
        asked = found if stretch == 1.0 else asked
        stretch *= _SLOWER
    return Guarded(None, 1.0, math.nan, f"tips over with {asked:.0%}: refused, at no speed it may")


def _holding(chain: SerialChain, place: FloatArray) -> SerialChain:
    """Return a chain without mass that holds 1 kg in a point of its last link."""
    bodies = [WEIGHTLESS] * (len(chain) - 1) + [RigidBody(1.0, place, np.zeros((3, 3)))]
    joints = tuple(
        dataclasses.replace(joint, body=body, rotor_inertia=0.0)
        for joint, body in zip(chain.joints, bodies)
    )
    return dataclasses.replace(chain, joints=joints, base=WEIGHTLESS)


def _followed(commanded: FloatArray, now: FloatArray) -> FloatArray:
    """Return how the rims (n, 2) follow commanded speeds, from those that they have."""
    share = PERIOD / (_LAG + PERIOD)
    kept = (1.0 - share) * now[None]
    return scipy.signal.lfilter([share], [1.0, share - 1.0], commanded, axis=0, zi=kept)[0]


def _first(happens: NDArray[np.bool_]) -> FloatArray:
    """Return the times (n,) at which something happens first [s], infinite for never."""
    return np.where(happens.any(axis=1), np.argmax(happens, axis=1) * PERIOD, math.inf)
