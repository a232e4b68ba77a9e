"""A controller that swings a rover's arm and identifies how the rover tilts under it."""

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from controllers.identification import ROVER_EXCITATIONS
from controllers.identification.arm_motion import (
    CONSTANT,
    ArmLimits,
    ArmState,
    Excitation,
    Trajectory,
    swing,
)
from controllers.identification.excitation import REPLAN_PERIOD, random_excitation
from controllers.identification.pitch import (
    CRITERIA,
    PitchData,
    PitchEstimate,
    PitchFit,
    PitchPrior,
    fisher_information,
)
from controllers.identification.pitch_model import PitchSensors, predict_tilt, smoothed
from controllers.identification.swing_plane import PITCH, SwingPlane
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_choice
from perception.geometry.gravity import GRAVITY
from twin.description import RobotDescription
from twin.robot import ArmMode, Command, Observation, RobotError

ROVER_ARM_LIMITS = ArmLimits(
    amplitude=(0.05, 0.7), offset=(0.75, np.pi / 2), rate=4.0, acceleration=12.0
)
"""Keeps the stretched arm above the ground in front and short of its stop behind, and all wheels
down on level ground."""

ROLL_TILT_LIMIT = np.deg2rad(0.3)
"""Greatest mean roll from rest that a plan may predict. If the centre joint leaves it all to the
front half, 3.3 N m lift one of its wheels, which carry 12 N each on half a track of 0.14 m. The
weight of the arm at rest is 1.2 N m of them; 0.3 deg on both halves' springs are 1.4 N m more."""

_GENTLER = (0.6,)
"""Shares of the arm's usual acceleration at which an identification in doubt is repeated: a wheel
that lifts or slips ruins the fit."""


@dataclasses.dataclass(frozen=True)
class SwingingArm:
    """Mass properties of the stretched arm, which swings about the shoulder in a vertical plane.

    Attributes:
        mass: Mass of all that swings [kg].
        inertia: About its centre, about x [kg m^2].
        centre: (2,) y, z of its centre from the shoulder at angle zero [m].
        shoulder: (2,) y, z of the shoulder from the force/torque sensor [m].
    """

    mass: float
    inertia: float
    centre: tuple[float, float]
    shoulder: tuple[float, float]

    @classmethod
    def of(cls, robot: RobotDescription) -> "SwingingArm":
        """Return the part of a robot's arm, stretched at angle zero, beyond its second joint.

        Args:
            robot: The robot as drawn.

        Raises:
            ValueError: If it has no arm.
        """
        if robot.arm is None:
            raise ValueError(f"robot {robot.name!r} has no arm to swing")
        arm = robot.arm
        _, *swinging = arm.joints
        masses = np.array([joint.body.mass for joint in swinging])
        steps = [joint.transform_link_to_parent.translation for joint in swinging]
        offsets = np.cumsum([np.zeros(3), *steps[1:]], axis=0)
        centres = offsets + [joint.body.centre for joint in swinging]
        centre = masses @ centres / masses.sum()
        levers = centres[:, 1:] - centre[1:]
        inertia = sum(joint.body.inertia[0, 0] for joint in swinging)
        inertia += masses @ np.sum(levers**2, axis=1)
        mount = arm.joints[0].transform_link_to_parent.translation + steps[0]
        return cls(
            float(masses.sum()),
            float(inertia),
            (float(centre[1]), float(centre[2])),
            (float(mount[1]), float(mount[2])),
        )

    def wrench(self, trajectory: Trajectory) -> FloatArray:
        """Return force and moment on the arm at the sensor (n + 1, 6), the base at rest."""
        cos, sin = np.cos(trajectory.angle), np.sin(trajectory.angle)
        y = cos * self.centre[0] - sin * self.centre[1]
        z = sin * self.centre[0] + cos * self.centre[1]
        rate_squared = trajectory.rate**2
        ay = -z * trajectory.acceleration - y * rate_squared
        az = y * trajectory.acceleration - z * rate_squared
        wrench = np.zeros((len(y), 6))
        wrench[:, 1], wrench[:, 2] = self.mass * ay, self.mass * (az + GRAVITY)
        y, z = y + self.shoulder[0], z + self.shoulder[1]
        wrench[:, 3] = self.inertia * trajectory.acceleration
        wrench[:, 3] += y * wrench[:, 2] - z * wrench[:, 1]
        return wrench


@dataclasses.dataclass(frozen=True)
class RoverIdentifierConfig:
    """Configuration of the controller.

    Attributes:
        robot: Name of the robot that it drives.
        arm: Known mass properties of its arm.
        excitation: One of `ROVER_EXCITATIONS`.
        limits: Limits of the shoulder's motion.
        sensors: Sampling and noise of the sensors.
        prior: Prior of the five parameters.
        approach: Time to bring the arm to its start [s].
        rest: Time at rest over which the sensors are tared [s].
        duration: Time of excitation [s].
        tilt_limit: Greatest tilt from rest that a plan may predict [rad]. The wheels carry 44 N
            on a half wheelbase of 0.15 m, so 6.6 N m, the arm's weight included, lift a pair of
            them, and the suspension is linear no more.
        plane: Plane in which the arm swings, and the base tilts.
    """

    robot: str
    arm: SwingingArm
    excitation: str = "information"
    limits: ArmLimits = ROVER_ARM_LIMITS
    sensors: PitchSensors = PitchSensors()
    prior: PitchPrior = PitchPrior()
    approach: float = 2.0
    rest: float = 1.5
    duration: float = 10.0
    tilt_limit: float = np.deg2rad(0.7)
    plane: SwingPlane = PITCH

    def __post_init__(self) -> None:
        """Refuse an unknown excitation.

        Raises:
            ValueError: Naming it and those that there are.
        """
        check_choice("excitation", self.excitation, ROVER_EXCITATIONS)

    @property
    def total(self) -> float:
        """Time that the whole identification takes [s]."""
        return self.approach + self.rest + self.duration


@dataclasses.dataclass
class Log:
    """Measurements and estimates since the tare.

    Attributes:
        times: Robot time of each tick since the excitation began [s].
        shoulder: Shoulder angle [rad].
        wrench: (6,) deviation from rest at each tick, frame of the plane.
        half_twist: Mean tilt of the front and the rear half less that of the front half at each
            tick, through the inclinometer's low pass, deviation from rest [rad].
        tilt: Mean tilt of the halves read, deviation from rest [rad].
        tilt_indices: Tick of each reading.
        lost: Whether the motion before each reading cannot have been as modelled.
        estimates: After each window.
        excitations: Excitation of each window.
        step_seconds: Time that each estimate and plan took together [s].
    """

    times: list[float] = dataclasses.field(default_factory=list)
    shoulder: list[float] = dataclasses.field(default_factory=list)
    wrench: list[FloatArray] = dataclasses.field(default_factory=list)
    half_twist: list[float] = dataclasses.field(default_factory=list)
    tilt: list[float] = dataclasses.field(default_factory=list)
    tilt_indices: list[int] = dataclasses.field(default_factory=list)
    lost: list[bool] = dataclasses.field(default_factory=list)
    estimates: list[PitchEstimate] = dataclasses.field(default_factory=list)
    excitations: list[Excitation] = dataclasses.field(default_factory=list)
    step_seconds: list[float] = dataclasses.field(default_factory=list)


class _Reading(NamedTuple):
    """What is read at a tick, frame of the plane.

    Attributes:
        wrench: (6,) force and moment on the arm [N, N m].
        tilt: Tilt of the front half [rad].
        half_twist: Mean tilt of the front and the rear half less that of the front half [rad].
    """

    wrench: FloatArray
    tilt: float
    half_twist: float


def _mean(readings: Sequence[_Reading]) -> _Reading:
    wrenches, tilts, twists = zip(*readings, strict=True)
    return _Reading(np.mean(wrenches, axis=0), float(np.mean(tilts)), float(np.mean(twists)))


class RoverIdentifier:
    """Approach, rest, excite; estimate and plan anew every 0.4 s.

    Args:
        config: Sensors, limits, prior and schedule of the identification.
        generator: Random generator of the planner's starting points and of random excitations.
    """

    def __init__(self, config: RoverIdentifierConfig, generator: np.random.Generator) -> None:
        self.config = config
        self._generator = generator
        self._gentler = [share * config.limits.acceleration for share in _GENTLER]
        self._window = round(REPLAN_PERIOD / config.sensors.period)
        self.reset()
        self._rehearse()
        self.reset()

    def reset(self) -> None:
        """Forget all data and start again with the approach."""
        self.log = Log()
        config = self.config
        self.fit = PitchFit(config.sensors, config.prior, names=config.plane.parameters)
        self._tick = 0
        self._start: FloatArray | None = None
        self._rests: list[_Reading] = []
        self._tare: _Reading | None = None
        self._last_tilt_stamp = -np.inf
        self._arm_state = ArmState()
        self._excitation = CONSTANT
        self._motion: Trajectory | None = None
        self._search: Iterator[None] | None = None

    def repeat(self) -> bool:
        """Start again with a gentler motion, and return whether there was one left."""
        if not self._gentler:
            return False
        limits = dataclasses.replace(self.config.limits, acceleration=self._gentler.pop(0))
        self.config = dataclasses.replace(self.config, limits=limits)
        self.reset()
        return True

    @property
    def done(self) -> bool:
        """True when the excitation is over."""
        return self._tick * self.config.sensors.period >= self.config.total

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Process one tick and return the arm's command.

        Raises:
            RobotError: If a sensor that the identification lives by is missing or stale.
        """
        observation = observations[self.config.robot]
        for name in self.config.plane.channels:
            channel = getattr(observation, name)
            if not channel.usable:
                raise RobotError(
                    f"{name} is {channel.validity.value}: identification needs it; "
                    "check its connection"
                )
        now = self._tick * self.config.sensors.period
        self._tick += 1
        if now < self.config.approach:
            return self._approach(observation, now)
        if now < self.config.approach + self.config.rest:
            return self._rest(observation, now)
        return self._excite(observation)

    def conclude(self) -> bool:
        """Do one iteration of the thorough fit of everything, and return whether it is over."""
        if self._search is None:
            self._search = self.fit.search(self._data())
        for _ in self._search:
            return False
        return True

    def finish(self) -> PitchEstimate:
        """Conclude at once, which takes up to a second, and return the estimate."""
        while not self.conclude():
            pass
        return self.fit.estimate

    def hold(self) -> Mapping[str, Command]:
        """Return the command that keeps the arm where it is meant to be by now."""
        return self._command(self._stretched(self._arm_state.angle), np.zeros(4))

    def _stretched(self, shoulder: float) -> FloatArray:
        """Return the angles (4,) of the arm stretched in its plane."""
        return np.array([self.config.plane.yaw, shoulder, 0.0, 0.0])

    def _approach(self, observation: Observation, now: float) -> Mapping[str, Command]:
        if self._start is None:
            self._start = np.array(observation.arm_angles.value, dtype=float)
        goal = self._stretched(self._arm_state.angle)
        share = min(1.0, now / (0.7 * self.config.approach))
        smooth = share * share * (3 - 2 * share)
        return self._command(self._start + smooth * (goal - self._start), np.zeros(4))

    def _rest(self, observation: Observation, now: float) -> Mapping[str, Command]:
        # The first half lets the rover settle; a tare from one sample would carry its noise.
        if now > self.config.approach + self.config.rest / 2:
            self._rests.append(self._read(observation))
        return self.hold()

    def _excite(self, observation: Observation) -> Mapping[str, Command]:
        phase = len(self.log.times) % self._window
        self._record(observation)
        if phase == 0:
            self._replan()
        assert self._motion is not None
        angles = self._stretched(self._motion.angle[phase + 1])
        return self._command(angles, np.array([0.0, self._motion.rate[phase + 1], 0.0, 0.0]))

    def _record(self, observation: Observation) -> None:
        """Append what is read in this tick to the log."""
        log, period = self.log, self.config.sensors.period
        tare = self._tare = self._tare or _mean(self._rests)
        read, tick = self._read(observation), len(log.times)
        log.times.append(tick * period)
        log.shoulder.append(float(observation.arm_angles.value[1]))
        log.wrench.append(read.wrench - tare.wrench)
        before = log.half_twist[-1] if log.half_twist else 0.0
        kept = np.exp(-2 * np.pi * self.config.sensors.tilt_bandwidth * period)
        log.half_twist.append(kept * before + (1.0 - kept) * (read.half_twist - tare.half_twist))
        stamp = observation.inclinometer.stamp
        if stamp > self._last_tilt_stamp:
            self._last_tilt_stamp = stamp
            read_at = tick - round((observation.time - stamp) / period)
            if read_at >= 0:
                log.tilt.append(read.tilt - tare.tilt + log.half_twist[read_at])
                log.tilt_indices.append(read_at)

    def _read(self, observation: Observation) -> _Reading:
        plane = self.config.plane
        return _Reading(
            plane.wrench(np.asarray(observation.arm_base_wrench.value, dtype=float)),
            plane.tilt(np.asarray(observation.inclinometer.value, dtype=float)),
            plane.half_twist(observation),
        )

    def _replan(self) -> None:
        start = time.perf_counter()
        if self.log.tilt:
            self.log.estimates.append(self.fit.fit(self._data(), iterations=4))
        if self.config.excitation == "random":
            self._excitation = random_excitation(self.config.limits, self._generator)
        elif self.config.excitation in CRITERIA and self.log.tilt:
            self._excitation = self._plan()
        self.log.step_seconds.append(time.perf_counter() - start)
        self.log.excitations.append(self._excitation)
        self._motion, self._arm_state = self._swing(self._excitation)

    def _swing(self, excitation: Excitation) -> tuple[Trajectory, ArmState]:
        period = self.config.sensors.period
        return swing(self._arm_state, excitation, self.config.limits, self._window, period)

    def _rehearse(self) -> None:
        """Load the compiled code: its first use takes seconds, after which a robot has stopped."""
        motion, _ = self._swing(CONSTANT)
        self.log.wrench = list(self.config.arm.wrench(motion))
        self.log.tilt, self.log.tilt_indices = [0.0], [0]
        self.fit.fit(self._data(), iterations=1)
        if self.config.excitation in CRITERIA:
            self._plan(candidates=1)

    def _data(self) -> PitchData:
        """Return all measurements, those since the last estimate looked through for surprises."""
        log, judged = self.log, len(self.log.lost)
        wrench = smoothed(np.array(log.wrench), self.config.sensors)
        data = PitchData.of(wrench, log.tilt_indices, log.tilt)
        data.lost[:judged] = log.lost
        if log.estimates:
            data = self.fit.with_losses(data, judged)
        log.lost = data.lost.tolist()
        return data

    def _plan(self, candidates: int = 12) -> Excitation:
        """Best of some random excitations and the present one, then least squares from there."""
        residuals = CRITERIA[self.config.excitation](self.fit.estimate)
        # The base's own memory is a few tenths of a second: a second of the past is enough.
        past = np.array(self.log.wrench[-round(1 / self.config.sensors.period) :])
        still = np.zeros(1)
        at_rest = Trajectory(0.0, np.array([ArmState().angle]), still, still, still[:0])
        rest = self.config.arm.wrench(at_rest)[0]
        bounds = self.config.limits.bounds()
        sensors = self.config.sensors

        def evaluate(vector: FloatArray) -> FloatArray:
            motion, _ = self._swing(Excitation(*vector.tolist()))
            forecast = self.config.arm.wrench(motion)[1:] - rest
            wrench = np.concatenate([past, forecast])
            added = fisher_information(self.fit.estimate, wrench, len(forecast), sensors)
            predicted = predict_tilt(self.fit.estimate.parameters, wrench, sensors)[len(past) :]
            tilt, apparent, _ = np.abs(predicted).max(axis=0)
            excess = max(tilt / self.config.tilt_limit, apparent / sensors.tilt_range) - 1
            return np.append(residuals(added), 10 * max(excess, 0.0))

        present = np.clip(self._excitation, bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6)
        drawn = (random_excitation(self.config.limits, self._generator) for _ in range(candidates))
        starts = np.array([present, *drawn])
        costs = [float(np.sum(evaluate(vector) ** 2)) for vector in starts]
        best = starts[int(np.argmin(costs))]
        span = bounds[:, 1] - bounds[:, 0]
        solution = scipy.optimize.least_squares(
            evaluate, best, bounds=(bounds[:, 0], bounds[:, 1]), x_scale=span, max_nfev=4
        )
        return Excitation(*solution.x.tolist())

    def _command(self, angles: FloatArray, rates: FloatArray) -> Mapping[str, Command]:
        return {self.config.robot: Command(arm=angles, arm_mode=ArmMode.POSITION, arm_rates=rates)}


class PitchSwing:
    """Identifies a rover's pitch dynamics; what is doubted is done again, gently.

    A `twin.robot.Controller` of one robot.

    Args:
        robot: The robot as drawn.
        rng: Random generator for the planner of the excitation.

    Attributes:
        done: Whether an identification succeeded, or the last has failed.
        estimate: Latest estimate of the pitch dynamics; None before the first.
        doubts: Why it is not to be used; none if it is.
    """

    def __init__(self, robot: RobotDescription, rng: np.random.Generator) -> None:
        self.done = False
        self.estimate: PitchEstimate | None = None
        self.doubts: tuple[str, ...] = ()
        config = RoverIdentifierConfig(robot.name, SwingingArm.of(robot))
        self._identifier = RoverIdentifier(config, rng)

    def reset(self) -> None:
        """Do nothing: each identification has a new one."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the command of the swing; at its end hold the arm and fit, a step each tick."""
        if not self._identifier.done:
            return self._identifier.step(observations)
        command = self._identifier.hold()
        if not self.done and self._identifier.conclude():
            self.estimate = self._identifier.fit.estimate
            self.doubts = self.estimate.doubts(self._identifier.config.prior)
            self.done = not (self.doubts and self._identifier.repeat())
        return command
