"""Jobs of ``appe-mechanism``: single stages, arms under their weight, words in a row."""

import dataclasses
import time

import numpy as np

from controllers.braid.arm.stage import STATES
from controllers.braid.bus.drive import EXTEND, RETRACT, DriveConfig, WireDrive, word_bits
from experiments.appe.mechanism.bench import BraidBench, ideal_tip, make_bench
from models.braid.build import BraidConfig
from models.datasheets import BRAID, MUSCLE_WIRE
from perception.geometry.arrays import FloatArray, IntArray

SETTLE = 1.0
"""Rest before an arm is measured [s]."""
# A pull of 1 % more than the barrier needs two seconds to creep over it.
_HEATING, _COOLING = 4.0, 3.0
_BISECTIONS = 7


@dataclasses.dataclass(frozen=True)
class ArmTrial:
    """Words of an arm.

    Attributes:
        stages: Number of the arm's stages.
        seed: Seed of the words.
        words: Number of random words.
        head: Whether the arm carries the stereo head.
        at_once: Number of legs that are heated together.
    """

    stages: int
    seed: int
    words: int
    head: bool = True
    at_once: int = 3


def settle_states(flexures: bool) -> tuple[FloatArray, FloatArray]:
    """Drive a stage without weight to each state from the opposite one.

    Args:
        flexures: Whether hinges are stiff.

    Returns:
        (8,) distance of the platform from the exact kinematics [m], (8,) angle to it [rad].
    """
    bench = make_bench(BraidConfig(1, head=False, flexures=flexures), gravity=False)
    place, angle = np.empty(STATES), np.empty(STATES)
    for state in range(STATES):
        opposite, wanted = np.array([STATES - 1 - state]), np.array([state])
        bench.put(opposite)
        drive = WireDrive(opposite)
        drive.change(wanted)
        bench.drive(drive)
        bench.step(SETTLE)
        off = bench.tip() - ideal_tip(wanted)
        place[state] = np.linalg.norm(off[:3])
        angle[state] = 2.0 * np.arcsin(np.linalg.norm(off[3:]) / np.sqrt(8.0))
    return place, angle


def pull(bench: BraidBench, leg: int, extend: bool, force: float) -> bool:
    """Let a leg's wires pull with a force [N] at most, and return whether it goes over.

    Args:
        bench: One stage at rest.
        leg: Index of the leg, 0 to 2.
        extend: Whether the extending bundle pulls; the leg starts in the other well.
        force: Limit of the force [N].
    """
    bench.put(np.array([0 if extend else 1 << leg]))
    index = bench.wires[0, leg, EXTEND if extend else RETRACT]
    full = bench.model.actuator_forcerange[index].copy()
    bench.model.actuator_forcerange[index, 1] = force
    bench.data.ctrl[index] = MUSCLE_WIRE.heating
    bench.step(_HEATING)
    bench.data.ctrl[index] = 0.0
    bench.step(_COOLING)
    bench.model.actuator_forcerange[index] = full
    return bool(bench.bits()[0, leg]) == extend


def find_barrier(bench: BraidBench, leg: int, extend: bool) -> float:
    """Return the least pull that switches a leg, over the barrier, by halving 0.9 to 1.1."""
    low, high = 0.9, 1.1
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if pull(bench, leg, extend, middle * BRAID.barrier):
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def toggle_course() -> FloatArray:
    """Follow one leg of a stage there and back.

    Returns:
        (n, 5) time [s], temperatures of both bundles of wires [K above ambient], travel of the leg
        from its middle [m], and the wires' force along it [N].
    """
    bench = make_bench(BraidConfig(1, head=False), gravity=False)
    bench.put(np.array([0]))
    drive = WireDrive(np.array([0]))
    start, rows = 0.0, []
    for state in (1, 0):
        drive.change(np.array([state]))
        for elapsed in bench.ticks(drive):
            index = bench.wires[0, 0]
            force = bench.data.actuator_force[index] @ [1.0, -1.0]
            heat = bench.data.act[index]
            rows.append((start + elapsed, *heat, bench.travel()[0, 0], force))
        start = rows[-1][0]
    return np.array(rows)


@dataclasses.dataclass(frozen=True)
class WordErrors:
    """How an arm holds m words.

    Attributes:
        wrong: (m,) number of legs whose state is not the word's.
        sag: (m,) distance of the tip from the exact kinematics [m].
        load: (m,) greatest load on a detent, over its barrier.
    """

    wrong: IntArray
    sag: FloatArray
    load: FloatArray


def word_errors(bench: BraidBench, word: IntArray) -> tuple[int, float, float]:
    """Return wrong legs, sag [m] and greatest load over the barrier of an arm in a word."""
    wrong = int(np.count_nonzero(bench.bits() != word_bits(word)))
    sag = float(np.linalg.norm(bench.tip()[:3] - ideal_tip(word)[:3]))
    return wrong, sag, float(bench.loads().max())


@dataclasses.dataclass(frozen=True)
class WordRun:
    """An arm driven from word to word.

    Attributes:
        errors: Errors of the arm in each word.
        changed: (m,) number of legs that changed.
        seconds: Simulated time [s].
        wall: Computing time [s].
        warnings: Number of MuJoCo's warnings.
    """

    errors: WordErrors
    changed: IntArray
    seconds: float
    wall: float
    warnings: int


def run_sag(trial: ArmTrial) -> WordErrors:
    """Put an arm into the eight words of equal stages and random ones, and let it sag."""
    bench = make_bench(BraidConfig(trial.stages, head=trial.head))
    rng = np.random.default_rng(trial.seed)
    equal = np.tile(np.arange(STATES)[:, None], trial.stages)
    rows = []
    for word in np.vstack([equal, rng.integers(0, STATES, (trial.words, trial.stages))]):
        bench.put(word)
        bench.step(SETTLE)
        rows.append(word_errors(bench, word))
    return WordErrors(*map(np.array, zip(*rows)))


def run_words(trial: ArmTrial) -> WordRun:
    """Drive an arm from word to word, wires and weight simulated."""
    bench = make_bench(BraidConfig(trial.stages, head=trial.head))
    rng = np.random.default_rng(trial.seed)
    word: IntArray = np.zeros(trial.stages, dtype=np.int64)
    bench.put(word)
    drive = WireDrive(word, DriveConfig(at_once=trial.at_once))
    rows, changed = [], []
    begun, since = time.perf_counter(), bench.data.time
    for _ in range(trial.words):
        before, word = word, rng.integers(0, STATES, trial.stages)
        drive.change(word)
        bench.drive(drive)
        rows.append(word_errors(bench, word))
        changed.append(np.count_nonzero(word_bits(before) != word_bits(word)))
    errors, wall = WordErrors(*map(np.array, zip(*rows))), time.perf_counter() - begun
    seconds = bench.data.time - since
    return WordRun(errors, np.array(changed), seconds, wall, bench.warnings())
