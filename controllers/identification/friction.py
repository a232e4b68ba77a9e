"""Wheel/ground friction and slip onset from the arm's own jerks (Thesis section 6.2 b).

The arm lies stretched forward and turns to and fro about the vertical, each reversal harder than
the one before, until the rover slips or the arm has nothing left. Only sensors of the physical
rover are used: the arm's encoders, the force/torque sensor under it, the inclinometer and, to see
whether the wheels rolled, their tachometers; neither accelerometer, nor gyro, nor heading.

Mechanics, all in the body frame at the rover's centre of gravity:

1. The wrench on the arm is that of an arm on a resting base plus M(q) a, where a (6,) is the
   acceleration of the base and M the arm's inertia with locked joints. Since M and the resting
   part are known, the measured wrench gives a: arm and sensor are an accelerometer of the base.
2. Newton and Euler for the rover without arm then give what the ground must supply: a horizontal
   force F and a moment Mz about the vertical. The normal forces N_i follow from the vertical force
   and the pitch and roll moments; the rear axle cannot take a roll moment, since it is hinged to
   the front, so its two wheels share evenly and the front ones take the rest.
3. Wheels that do not slide can hold any friction forces with |f_i| <= mu N_i that balance F and Mz.
   By the limit theorems of plasticity the smallest mu for which there are such forces is

       u = max over motions (v, w) of (F . v + Mz w) / sum_i N_i |v + w x r_i|.

   So u is the friction that is being used: u <= mu always, and u = mu while all wheels slide,
   whatever the share of force and moment.

An arm as made, and its sensors, are off by more than the arm can tell of the base. So it swings
slowly before, on wheels that hold, and what its drawing leaves unknown is found (`arm_deviations`);
then it turns stretched and slowly over its whole reach, and what the wrench shows there beyond what
the arm explains is taken off all that follows, by the yaw.

Slip shows in the yaw rate of the base, the leaky integral of its acceleration: on holding wheels
the base only gives a little and comes back, so a slip is a turn by more than a small angle. While
the arm's jerk sets the rover sliding, the filter blurs acceleration and wrench by a few ticks and u
overshoots; while friction alone brakes the slide it does not. So the estimate is the median of u
over the braking half of the slides with all wheels loaded, if that lasted for two windows of the
filter at least: from fewer samples the median is chance. The lower bound, for all other runs, is
the greatest u that lasts for a window with all wheels loaded, less a margin for the overshoot.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import lfilter

from controllers.identification.arm_deviations import ArmAsMade, ArmDeviations, calibrate
from controllers.identification.arm_sensing import (
    CHANNELS,
    ArmRecord,
    ObservationLog,
    SensingConfig,
    filter_alike,
    read_arm,
)
from controllers.identification.payload import WIDE_SWING, SwingConfig, swing_targets
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import BoolArray, FloatArray
from twin.description import RigidBody, RobotDescription
from twin.robot import ArmMode, Command, Observation, WheelMode

_SWEEP_PEAK = 0.6495
"""Largest sin(x) sin(x / 2)^2, of the slow turn: 3 sqrt(3) / 8, at 2 pi / 3."""


def normal_forces(force: FloatArray, moment: FloatArray, wheels: FloatArray) -> FloatArray:
    """Return (n, 4) normal forces of the wheels [N]; a wheel that would have to pull gives none.

    Args:
        force: (n, 3) by the ground on the rover, body frame [N].
        moment: (n, 3) of it about the centre of gravity [N m].
        wheels: (4, 3) contacts, front left, front right, rear left, rear right [m].
    """
    half_track, height = float(wheels[1, 0]), -float(wheels[0, 2])
    front, rear = float(wheels[0, 1]), float(wheels[2, 1])
    ahead = moment[:, 0] - height * force[:, 1]
    front_share = (ahead - rear * force[:, 2]) / (front - rear)
    rear_share = force[:, 2] - front_share
    across = (-moment[:, 1] - height * force[:, 0]) / half_track
    shares = (front_share - across, front_share + across, rear_share, rear_share)
    return np.maximum(np.stack(shares, axis=1) / 2.0, 0.0)


def friction_in_use(
    force: FloatArray, moment: FloatArray, normals: FloatArray, wheels: FloatArray, rounds: int = 60
) -> FloatArray:
    """Return (n,) the smallest friction coefficient with which wheels can hold a load.

    The motion that dissipates least for one unit of the load's power is found by iteratively
    reweighted least squares (Weiszfeld's method for sums of lengths).

    Args:
        force: (n, 2) horizontal [N].
        moment: (n,) about the vertical through the origin of `wheels` [N m].
        normals: (n, 4) normal forces [N].
        wheels: (4, 2) contacts [m].
        rounds: Iterations.
    """
    load = np.concatenate([force, moment[:, None]], axis=1)
    # velocity of contact i = rows[i] @ (vx, vy, w)
    rows = np.zeros((len(wheels), 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1.0
    rows[:, 0, 2], rows[:, 1, 2] = -wheels[:, 1], wheels[:, 0]
    squares = np.einsum("wij,wik->wjk", rows, rows)
    speeds = np.ones_like(normals)
    dissipated: FloatArray = np.full(len(load), np.inf)
    floor = 1e-9 * np.eye(3)
    for _ in range(rounds):
        weights = np.einsum("nw,wjk->njk", (normals + 1e-6) / speeds, squares) + floor
        motion = np.linalg.solve(weights, load[..., None])[..., 0]
        power = np.sum(motion * load, axis=1)
        motion /= np.maximum(power, 1e-12)[:, None]
        lengths = np.linalg.norm(np.einsum("wij,nj->nwi", rows, motion), axis=2)
        dissipated = np.minimum(dissipated, np.sum(normals * lengths, axis=1))
        speeds = np.maximum(lengths, 1e-6 * np.max(lengths, axis=1, keepdims=True) + 1e-12)
    loaded = np.linalg.norm(load, axis=1) > 1e-9
    return np.where(loaded, 1.0 / np.maximum(dissipated, 1e-9), 0.0)


@dataclasses.dataclass(frozen=True)
class KnownBase:
    """The rover without its arm, in the body frame.

    Attributes:
        body: All of it, wheels included.
        mount: (3,) the arm's base frame, its axes those of the body [m].
        wheels: (4, 3) where the tyres meet the ground, front left, front right, rear left, rear
            right [m].
    """

    body: RigidBody
    mount: FloatArray
    wheels: FloatArray

    @classmethod
    def of_robot(cls, robot: RobotDescription) -> "KnownBase":
        """Return the base of a rover with four wheels, as drawn.

        Args:
            robot: The rover, with its arm.

        Raises:
            ValueError: If it has no arm or not four wheels.
        """
        if robot.arm is None or len(robot.wheels) != 4:
            raise ValueError(f"robot {robot.name}: expected an arm and four wheels")
        wheels = np.array([wheel.centre for wheel in robot.wheels])
        wheels[:, 2] = -robot.centre_height
        return cls(robot.body, np.asarray(robot.arm.transform_base_to_robot.translation), wheels)


@dataclasses.dataclass(frozen=True)
class JerkConfig:
    """Jerks of the arm that are to break the rover loose.

    Attributes:
        posture: (4,) joint angles of the stretched arm [rad].
        reach: Yaw at which the arm turns back [rad].
        rates: First and greatest yaw rate between two reversals [rad/s].
        growth: Added to the rate at each reversal [rad/s].
        approach: Time to take the posture [s].
        sweep: Time of a slow turn to both sides in it, before the first jerk [s]; 0 for none.
    """

    posture: tuple[float, ...] = (0.0, 0.15, -0.1, 0.0)
    reach: float = 0.35
    rates: tuple[float, float] = (0.4, 4.6)
    growth: float = 0.2
    approach: float = 1.5
    sweep: float = 0.0


@dataclasses.dataclass(frozen=True)
class FrictionConfig:
    """Prior knowledge and settings of the friction estimate.

    Attributes:
        arm: The arm, with whatever it holds.
        base: The rover without arm.
        sensing: Interpretation of the measured signals.
        jerks: Motion of the arm.
        window: Ticks under the filter of both sides, odd.
        memory: Time constant of the integral of the base's yaw acceleration [s].
        slip_rates: Yaw rates of the base from which it may slip, and surely slides [rad/s].
        slip_angle: Turn above which it was a slip [rad].
        least_normal: Normal force below which a wheel no longer counts as loaded [N]: a quarter of
            its share; where less is left, its errors count for too much.
        least_use: Part of a slide's usual friction in use below which the wheels hold again.
        wrench_error: (6,) standard deviation of the filtered wrench's difference to the known arm,
            joint accelerations' errors included [N, N m].
        base_sigma: Usual linear [m/s^2] and angular [rad/s^2] acceleration of the base.
        margin: Possible excess of the friction in use, subtracted from the lower bound: a part of
            it, and a constant.
        rolling: Wheel speed above which a wheel rolled and did not only slide [rad/s].
        deviations: What is unknown of arm and sensors; None for ones that are their drawings.
        swing: Slow motion of the arm before the jerks, from which that is found.
        calibration: Duration of that motion [s]; 0 for none.
        swing_window: Ticks under the filter of both sides in that motion, odd.
        wrench_noise: (6,) standard deviation of a wrench sample [N, N m].
    """

    arm: SerialChain
    base: KnownBase
    sensing: SensingConfig = dataclasses.field(default_factory=SensingConfig)
    jerks: JerkConfig = dataclasses.field(default_factory=JerkConfig)
    window: int = 7
    memory: float = 0.4
    slip_rates: tuple[float, float] = (0.1, 0.2)
    slip_angle: float = 0.03
    least_normal: float = 3.0
    least_use: float = 0.55
    wrench_error: tuple[float, ...] = (0.1, 0.1, 0.1, 0.02, 0.02, 0.02)
    base_sigma: tuple[float, float] = (3.0, 20.0)
    margin: tuple[float, float] = (0.35, 0.01)
    rolling: float = 0.3
    deviations: ArmDeviations | None = None
    swing: SwingConfig = WIDE_SWING
    calibration: float = 0.0
    swing_window: int = 199
    wrench_noise: tuple[float, ...] = (0.1, 0.1, 0.1, 0.01, 0.01, 0.01)


@dataclasses.dataclass(frozen=True)
class GroundLoad:
    """Load that the ground must supply at each sample, and the friction in use.

    Attributes:
        times: (n,) [s].
        force: (n, 2) horizontal force on the rover, body frame [N].
        moment: (n,) about the vertical through the centre of gravity [N m].
        normals: (n, 4) normal forces of the wheels [N].
        yaw_acceleration: (n,) of the base [rad/s^2].
        yaw_rate: (n,) of the base, by leaky integration [rad/s].
        used: (n,) friction coefficient in use.
    """

    times: FloatArray
    force: FloatArray
    moment: FloatArray
    normals: FloatArray
    yaw_acceleration: FloatArray
    yaw_rate: FloatArray
    used: FloatArray


@dataclasses.dataclass(frozen=True)
class FrictionEstimate:
    """Friction of the ground by one run.

    Attributes:
        slipped: Whether the rover slipped.
        friction: The coefficient; NaN if it did not slip, or too briefly.
        lower_bound: Lower bound of the coefficient.
        onset: Time of the first slip [s]; NaN if there was none.
        rolled: Whether a wheel rolled against its brake, so that not all of the motion was slip.
        load: The samples behind it.
        slipping: (n,) samples at which the rover slipped.
    """

    slipped: bool
    friction: float
    lower_bound: float
    onset: float
    rolled: bool
    load: GroundLoad
    slipping: BoolArray


class FrictionProbe:
    """Jerks one robot's arm, and estimates the friction under its wheels.

    Args:
        robot: Name of the robot.
        config: Known arm and base, motion and thresholds.
    """

    def __init__(self, robot: str, config: FrictionConfig) -> None:
        self._robot = robot
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        channels = (*CHANNELS, "wheel_speeds")
        self._log = ObservationLog("friction estimation", channels)
        self._swing = ObservationLog("friction estimation", channels)
        self._start: FloatArray | None = None
        self._posed: FloatArray | None = None
        self._begin = 0.0
        self._rate = self._config.jerks.rates[0]

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Record, and swing or jerk on, with the wheels held.

        Raises:
            IdentificationError: If a sensor that is needed is missing or reads nonsense.
        """
        seen, config = observations[self._robot], self._config
        angles = seen.arm_angles.value.astype(float)
        if self._start is None:
            self._start, self._begin = angles, seen.time
        time = seen.time - self._begin
        swinging = time < config.calibration
        (self._swing if swinging else self._log).take(seen)
        if swinging:
            targets, rates = swing_targets(config.swing, self._start, time)
        else:
            targets, rates = self._targets(time - config.calibration, angles)
        command = Command(
            wheel_mode=WheelMode.SPEED, arm=targets, arm_mode=ArmMode.POSITION, arm_rates=rates
        )
        return {self._robot: command}

    def _targets(self, time: float, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return joint angles and rates to ask for; the yaw is driven by its rate alone."""
        jerks = self._config.jerks
        posture, rates = np.array(jerks.posture), np.zeros(4)
        if self._posed is None:
            self._posed = angles
        if time < jerks.approach:
            share = 0.5 - 0.5 * np.cos(np.pi * time / jerks.approach)
            return self._posed + share * (posture - self._posed), rates
        if time < jerks.approach + jerks.sweep:
            # It begins and ends in the middle and at rest.
            phase = 2.0 * np.pi * (time - jerks.approach) / jerks.sweep
            posture[0] += jerks.reach * np.sin(phase) * np.sin(phase / 2.0) ** 2 / _SWEEP_PEAK
            return posture, rates
        if abs(self._rate) > jerks.rates[1]:
            posture[0] = np.clip(angles[0], -jerks.reach, jerks.reach)
            return posture, rates
        if (angles[0] - posture[0]) * np.sign(self._rate) > jerks.reach:
            self._rate = -np.sign(self._rate) * (abs(self._rate) + jerks.growth)
        posture[0], rates[0] = angles[0], self._rate
        return posture, rates

    def estimate(self) -> FrictionEstimate:
        """Return the friction, from all that was recorded once the arm was stretched.

        Raises:
            IdentificationError: If the run is too short.
        """
        config = self._config
        self._log.forget_before(self._begin + config.calibration + config.jerks.approach)
        if not config.calibration:
            return estimate_friction(self._log, config)
        self._swing.forget_before(self._begin + config.swing.fade)
        return estimate_friction(self._log, config, self._swing)


def estimate_friction(
    log: ObservationLog, config: FrictionConfig, swing: ObservationLog | None = None
) -> FrictionEstimate:
    """Return the friction of the ground by one run.

    Args:
        log: Log of the channels of `arm_sensing.CHANNELS` and of ``wheel_speeds``, from the slow
            turn or, without one, the first jerk on.
        config: Known arm and base, motion and thresholds.
        swing: Log of the slow swing before; None for none.

    Raises:
        IdentificationError: If the run is too short.
    """
    record = read_arm(log, config.sensing)
    if swing is not None and config.deviations is not None:
        made = calibrate(
            read_arm(swing, config.sensing),
            config.swing_window,
            np.array(config.wrench_noise),
            ArmAsMade.drawn(config.arm, config.deviations),
        )
        record, config = tared(record, made, config)
    load = ground_load(record, config)
    slipping = slides(load, config)
    braking = brakes(load, slipping, config)
    slipped = bool(np.any(braking))
    enough = np.count_nonzero(braking) >= 2 * config.window
    return FrictionEstimate(
        slipped=slipped,
        friction=float(np.median(load.used[braking])) if enough else float("nan"),
        lower_bound=held_with(load, config),
        onset=float(load.times[slipping][0]) if slipped else float("nan"),
        rolled=bool(np.max(np.abs(log.values("wheel_speeds"))) > config.rolling),
        load=load,
        slipping=slipping,
    )


def tared(
    record: ArmRecord, made: ArmAsMade, config: FrictionConfig
) -> tuple[ArmRecord, FrictionConfig]:
    """Return a record as an exact arm with exact sensors shows it, and the settings with that arm.

    Args:
        record: Samples of the arm as measured, from the slow turn before the first jerk on.
        made: Arm and sensors as calibrated.
        config: Settings with the arm as drawn.
    """
    moved = dataclasses.replace(made.motion(record), wrench=made.felt(record))
    arm, slow = made.bodies, record.times < record.times[0] + config.jerks.sweep
    motion = moved.angles, moved.rates, moved.accelerations, moved.base
    left = (moved.wrench - arm.inverse_dynamics(*motion)[1])[slow]
    # What is left of cross-talk and tilt changes with the yaw.
    turned = np.vander(record.angles[:, 0], 3)
    offset = turned @ np.linalg.lstsq(turned[slow], left, rcond=None)[0]
    return (
        dataclasses.replace(moved, wrench=moved.wrench - offset),
        dataclasses.replace(config, arm=arm),
    )


def slides(load: GroundLoad, config: FrictionConfig) -> BoolArray:
    """Return (n,) whether the rover slipped at each sample.

    Args:
        load: Load that the ground supplied.
        config: Rate and angle above which a turn is a slip.
    """
    period = float(np.median(np.diff(load.times)))
    moving = np.abs(load.yaw_rate) > config.slip_rates[0]
    turning = np.sign(load.yaw_rate) * moving
    edges = np.flatnonzero(np.diff(turning, prepend=0.0, append=0.0))
    result = np.zeros(len(moving), dtype=bool)
    for begin, end in zip(edges[:-1], edges[1:]):
        angle = period * float(np.sum(np.abs(load.yaw_rate[begin:end])))
        result[begin:end] = moving[begin] and angle > config.slip_angle
    return result


def loaded(load: GroundLoad, config: FrictionConfig) -> BoolArray:
    """Return (n,) whether all wheels pressed on the ground at each sample."""
    return np.asarray(np.min(load.normals, axis=1) > config.least_normal)


def held_with(load: GroundLoad, config: FrictionConfig) -> float:
    """Return the greatest friction in use for a window of the filter, less a margin.

    Shorter peaks may be those of links that strike through the play of their gears.

    Args:
        load: Load that the ground supplied.
        config: Window of the filter and margin.
    """
    lasting = median_filter(load.used, config.window)[loaded(load, config)]
    part, constant = config.margin
    return max(0.0, float(np.max(lasting, initial=0.0)) * (1.0 - part) - constant)


def brakes(load: GroundLoad, slipping: BoolArray, config: FrictionConfig) -> BoolArray:
    """Return (n,) whether friction alone braked a slide at each sample, with all wheels loaded.

    What the integral of the yaw acceleration has left over, or an error of arm or sensors has
    brought into it, may look like a slide on wheels that hold; there less friction is in use
    than they have held with, so such samples are left out.

    Args:
        load: Load that the ground supplied.
        slipping: (n,) from `slides`.
        config: Thresholds of slip and of braking.
    """
    sliding = slipping & loaded(load, config)
    if not np.any(sliding):
        return sliding
    usual = config.least_use * np.quantile(load.used[sliding], 0.9)
    # Wheels that held with more do not slide with less.
    held = held_with(load, config)
    braking = sliding & (load.yaw_acceleration * load.yaw_rate < 0.0)
    braking &= load.used > max(usual, held)
    return braking & (np.abs(load.yaw_rate) > config.slip_rates[1])


def ground_load(record: ArmRecord, config: FrictionConfig) -> GroundLoad:
    """Return what the ground must supply, filtered.

    Args:
        record: Samples of the arm.
        config: Known arm and base, motion and thresholds.
    """
    motion = record.angles, record.rates, record.accelerations
    extra, wrench, locked, gravity, times = (
        filter_alike(values, config.window)
        for values in (
            record.wrench - config.arm.inverse_dynamics(*motion, record.base)[1],
            record.wrench,
            config.arm.base_inertia(record.angles),
            record.base.specific_force,
            record.times,
        )
    )
    moving = base_acceleration(locked, extra, config)
    linear, angular = moving[:, :3], moving[:, 3:]
    body, mount = config.base.body, config.base.mount
    at_centre = gravity + linear - np.cross(angular, mount)
    force = body.mass * at_centre + wrench[:, :3]
    moment = angular @ body.inertia + wrench[:, 3:] + np.cross(mount, wrench[:, :3])
    normals = normal_forces(force, moment, config.base.wheels)
    used = friction_in_use(force[:, :2], moment[:, 2], normals, config.base.wheels[:, :2])
    period = float(np.median(np.diff(times)))
    leak = float(np.exp(-period / config.memory))
    yaw_rate = np.asarray(lfilter([period], [1.0, -leak], angular[:, 2]))
    return GroundLoad(times, force[:, :2], moment[:, 2], normals, angular[:, 2], yaw_rate, used)


def base_acceleration(locked: FloatArray, extra: FloatArray, config: FrictionConfig) -> FloatArray:
    """Return (n, 6) the base's linear [m/s^2] and angular [rad/s^2] acceleration, body frame.

    The arm has little inertia about its own length, so the equations are solved with the usual
    size of the accelerations as prior knowledge: what the wrench does not show stays near zero.

    Args:
        locked: (n, 6, 6) wrench per acceleration.
        extra: (n, 6) wrench that the known arm on a resting base does not explain.
        config: Errors and usual sizes.
    """
    sigma = np.array(config.wrench_error)
    linear, angular = config.base_sigma
    prior = np.diag([linear**-2] * 3 + [angular**-2] * 3)
    weighted = locked / sigma[:, None]
    turned = np.swapaxes(weighted, 1, 2)
    right = turned @ (extra / sigma)[..., None]
    solved = np.linalg.solve(turned @ weighted + prior, right)[..., 0]
    return np.asarray(solved, dtype=float)
