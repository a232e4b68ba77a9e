"""The jobs of ch5-contact: contact states pressed and classified, and insertions."""

import dataclasses
import math

import numpy as np

from controllers.insertion.contact import (
    STATES,
    CardInSlot,
    contact_point,
    contacts_of,
    pose_in_state,
    wrench_cone,
)
from controllers.insertion.contact_states import WrenchNoise, classify
from controllers.insertion.guide import GuideConfig, InsertionGuide, Phase, StraightInsertion
from experiments.ch5.contact.bench import Bench, HandAsMade, press, shape_of
from models.datasheets import CARD_AND_SLOT, DEGREE, FORCE_TORQUE, HAND, INCH
from perception.geometry.arrays import FloatArray
from twin.optics.realism import RealismName
from twin.realism import realism_of

NOISES = (0.0, 0.02, 0.04, 0.06, 0.08, 0.10)
"""Sensor noise of figure A-7, fraction of the force."""
CLASSIFIED_NOISES = (0.05, 0.10)
"""Besides `NOISE`, at which states are classified."""
NOISE = 0.02
POSE_SIGMA = 0.5
"""Standard deviation of the pose estimate [mm and deg], as of the stereo head at half a metre."""
OTHER_SIGMAS = (1.0, 2.0, 4.0)
LEVELS = (
    *((noise, POSE_SIGMA) for noise in CLASSIFIED_NOISES),
    *((NOISE, sigma) for sigma in OTHER_SIGMAS),
)
"""Noise of the force and standard deviation of the pose at which states are classified besides."""
OFFSET, TILT = 4e-3, 6.0 * DEGREE
"""Widest misalignment."""
IMPOSSIBLE = 4.2 * INCH
"""Width of a slot that the card cannot enter [m]."""
RINGS = (1, 2, 3)
"""Thirds of the widest misalignment."""
STAND_OFF = 0.015
"""Distance of the leading edge before the mouth at the start [m]."""
LIMIT = 50.0
"""Longest insertion [s]."""
TARE = 0.5
"""Time over which the zero of a sensor that is off is taken, before the slot [s]."""
_HAND = 21  # Stream of random numbers of the hand.


@dataclasses.dataclass(frozen=True)
class StateJob:
    """One state in one slot.

    Attributes:
        state: 1 to 6.
        width: Width of the slot [m].
        seed: Seed of poses, loads and noise.
        poses: Number of different poses.
        samples: Number of noisy wrenches at each pose.
        realism: How far the hand and its sensor are from their drawings.
    """

    state: int
    width: float
    seed: int
    poses: int = 10
    samples: int = 3
    realism: RealismName = "ideal"


@dataclasses.dataclass(frozen=True)
class InsertionJob:
    """One insertion.

    Attributes:
        width: Width of the slot [m].
        ring: Which third of the widest misalignment, 1 to 3.
        guided: Whether force guides the insertion; if not it goes straight ahead.
        seed: Seed of misalignment and noise, the same for both methods of insertion.
        trace: Whether the result holds the course.
        realism: How far the hand and its sensor are from their drawings.
    """

    width: float
    ring: int
    guided: bool
    seed: int
    trace: bool = False
    realism: RealismName = "ideal"


@dataclasses.dataclass(frozen=True)
class StatesResult:
    """How well the contact states of one job were classified.

    Attributes:
        classified: (6,) how often each state was named at 2 % noise.
        by_noise: (2,) fractions right at `CLASSIFIED_NOISES`.
        by_sigma: (3,) fractions right at `OTHER_SIGMAS`.
        location_mm: (6, n) errors of the contact point at `NOISES`; empty for two contacts.
        drawn: Number of poses that were drawn.
        off_mm: Largest distance of the pressed card from the constructed pose.
    """

    classified: FloatArray
    by_noise: FloatArray
    by_sigma: FloatArray
    location_mm: FloatArray
    drawn: int
    off_mm: float


@dataclasses.dataclass(frozen=True)
class InsertionResult:
    """How an insertion ended.

    Attributes:
        success: Whether the guide reports success and the card is truly within 1 mm of the depth.
        peak: Largest true contact force [N].
        seconds: Duration [s].
        reason: Why it failed; empty if it did not.
        tries: Number of further attempts.
        offset: Misalignment across [m].
        tilt: Misalignment of the angle [rad].
        finite: Whether the final state was finite.
        course: (n, 11) time, command, true pose, true contact wrench and phase; empty without
            `InsertionJob.trace`.
    """

    success: bool
    peak: float
    seconds: float
    reason: str
    tries: int
    offset: float
    tilt: float
    finite: bool
    course: FloatArray


def run_states(job: StateJob) -> StatesResult:
    """Press the card into a state again and again, and classify what the hand feels.

    Truth is what touches in MuJoCo; poses where other features came to touch are drawn again.
    """
    rng = np.random.default_rng([job.seed, job.state, round(job.width * 1e6)])
    bench, shape = _bench(job), shape_of(job.width)
    named, right = np.zeros(6, dtype=int), np.zeros(len(LEVELS))
    located: list[list[float]] = [[] for _ in NOISES]
    drawn, off = 0, 0.0
    for _ in range(job.poses):
        while True:
            drawn += 1
            side = int(rng.choice([-1, 1]))
            pose = draw_pose(shape, job.state, side, rng)
            press(bench, pose, _draw_load(shape, pose, job.state, side, rng))
            if bench.true_state() == (job.state, side):
                break
        true, load = bench.pose, bench.sensed - bench.zero
        off = max(off, float(np.linalg.norm(true[:2] - pose[:2])))
        for _ in range(job.samples):
            named[_named(shape, load, true, (NOISE, POSE_SIGMA), rng) - 1] += 1
        for index, level in enumerate(LEVELS):
            right[index] += (_named(shape, load, true, level, rng) == job.state) / job.poses
        if len(STATES[job.state]) == 1:
            point = bench.touched()[0]
            for errors, noise in zip(located, NOISES):
                for _ in range(job.samples):
                    felt = _felt(load, WrenchNoise(noise), rng)
                    error = np.linalg.norm(contact_point(shape, felt) - point)
                    errors.append(1e3 * float(error))
    by_noise, by_sigma = np.split(right, [len(CLASSIFIED_NOISES)])
    return StatesResult(named, by_noise, by_sigma, np.array(located), drawn, 1e3 * off)


def draw_pose(shape: CardInSlot, state: int, side: int, rng: np.random.Generator) -> FloatArray:
    """Draw a constructed pose of a state: tilts and places where it exists."""
    steepest = math.acos(shape.card_width / shape.slot_width)
    while True:
        tilt = rng.uniform(1.5, 8.0) * DEGREE
        if state == 4:
            tilt = steepest + rng.uniform(1.0, 10.0) * DEGREE
        elif state == 5:
            tilt = rng.uniform(2.0 * DEGREE, steepest)
        place = rng.uniform(1e-3, 10e-3) if state in (1, 3) else rng.uniform(4e-3, 30e-3)
        try:
            return pose_in_state(shape, state, side, tilt, place)
        except ValueError:
            continue  # not there: the card would overlap the slot elsewhere


def _draw_load(
    shape: CardInSlot, pose: FloatArray, state: int, side: int, rng: np.random.Generator
) -> FloatArray:
    """Draw a wrench of 1 to 3 N at each contact, up to 90 % of the friction either way."""
    contacts = contacts_of(shape, pose, state, side)
    shares: list[float] = []
    for _ in contacts:
        normal, used = rng.uniform(1.0, 3.0), rng.uniform(-0.9, 0.9)
        shares += [normal * (1.0 - used) / 2.0, normal * (1.0 + used) / 2.0]
    return wrench_cone(contacts, shape.friction) @ shares


def _felt(load: FloatArray, noise: WrenchNoise, rng: np.random.Generator) -> FloatArray:
    return load + rng.normal(size=3) * noise.sigma(load)


def _named(
    shape: CardInSlot,
    load: FloatArray,
    pose: FloatArray,
    level: tuple[float, float],
    rng: np.random.Generator,
) -> int:
    """Return the state that a noisy wrench and a pose estimate show, at one of `LEVELS`."""
    sensor, sigmas = WrenchNoise(level[0]), level[1] * np.array([1e-3, 1e-3, DEGREE])
    believed = pose + rng.normal(size=3) * sigmas
    return classify(shape, _felt(load, sensor, rng), sensor, believed, np.diag(sigmas**2)).state


def _bench(job: StateJob | InsertionJob) -> Bench:
    """Return the bench of a job, whose hand does not depend on what is done with it."""
    hand = np.random.default_rng([job.seed, _HAND])
    return Bench(job.width, HandAsMade.drawn_from(job.realism, hand))


def guide_config(realism: RealismName) -> GuideConfig:
    """Return the settings of both ways to insert.

    Args:
        realism: How far hand and sensor are from their drawings.
    """
    sheet = CARD_AND_SLOT
    drawn = GuideConfig(sheet.card_width, sheet.friction, HAND.stiffness)
    if realism_of(realism).sensor_errors is None:
        return drawn
    return dataclasses.replace(drawn, tare=TARE)


def run_insertion(job: InsertionJob) -> InsertionResult:
    """Insert the card once from a drawn misalignment."""
    rng = np.random.default_rng([job.seed, job.ring, round(job.width * 1e6)])
    low, high = (job.ring - 1) / len(RINGS), job.ring / len(RINGS)
    sizes = rng.uniform(low, high, 2) * rng.choice([-1.0, 1.0], 2)
    wrong = np.array([sizes[0] * OFFSET, 0.0, sizes[1] * TILT])
    bench = _bench(job)
    config = guide_config(job.realism)
    start = np.array([0.0, -STAND_OFF, 0.0])
    guide = (InsertionGuide if job.guided else StraightInsertion)(config, start)
    sensor = WrenchNoise(NOISE, FORCE_TORQUE.force_noise, FORCE_TORQUE.torque_noise)
    bench.place(start + wrong)
    peak, course = 0.0, []
    for tick in range(round(LIMIT / config.period)):
        command = guide.step(_felt(bench.sensed, sensor, rng))
        bench.command(command + wrong)
        peak = max(peak, bench.step(config.period))
        if job.trace:
            phase = list(Phase).index(guide.phase)
            row = [tick * config.period, *(command + wrong), *bench.pose, *bench.contact_wrench()]
            course.append([*row, phase])
        if guide.over:
            break
    return InsertionResult(
        success=bool(guide.phase is Phase.DONE and bench.pose[1] >= config.depth - 1e-3),
        peak=peak,
        seconds=bench.data.time,
        reason=guide.reason,
        tries=guide.tries,
        offset=wrong[0],
        tilt=wrong[2],
        finite=bool(np.all(np.isfinite(bench.data.qpos))),
        course=np.array(course),
    )
