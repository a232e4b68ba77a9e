"""One trial of ``appe-bus``: words sent over a sampled bus, and what became of them."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from controllers.braid.bus.circuit import BusCircuit, PowerBus, with_rc_buffer
from controllers.braid.bus.code import DEFAULT_TIMING
from controllers.braid.bus.master import BusMaster, ChangeOutcome, planned_commands, protocols
from controllers.braid.bus.trains import Disturbance, OneFault, random_faults
from perception.geometry.arrays import FloatArray

ACTUATORS = 15  # Five stages, as the thesis built.
PROTOCOLS = ("thesis", "parity", "repeat", "correct")
REDRAW = 10  # Words between new components, where words do not follow each other.
FATES = ("right", "told", "skipped", "wrong")
"""Word right; wrong, and the master knows; actuators that did not move; wrong ones that did."""


@dataclasses.dataclass(frozen=True)
class BusTrialConfig:
    """A trial's settings.

    Attributes:
        protocol: One of `PROTOCOLS`.
        words: Number of words sent.
        seed: Random seed of words, components, noise and faults.
        buffer: "flag" or "rc".
        rc_sigma: Relative standard deviation of the RC buffers' times.
        margin: Delay of the RC buffer over the longest train.
        noise: Standard deviation of the noise on each sample of the signal [V].
        missed: Probability that a pulse is missed.
        extra: Probability that an extra pulse follows one.
        missed_flag: Probability that a flag is missed.
        fault: One of the kinds of fault, to befall each word once; or "none".
        lasting: Whether errors stay, one word after another; or each word starts from a known one.
    """

    protocol: str
    words: int
    seed: int
    buffer: str = "flag"
    rc_sigma: float = 0.05
    margin: float = 1.3
    noise: float = 0.0
    missed: float = 0.0
    extra: float = 0.0
    missed_flag: float = 0.0
    fault: str = "none"
    lasting: bool = False


def build_bus(config: BusTrialConfig, rng: np.random.Generator) -> PowerBus:
    """Return the bus of a trial with components of its own."""
    code = protocols(ACTUATORS)[config.protocol].code
    circuit, timing = BusCircuit(noise=config.noise, rc_sigma=config.rc_sigma), DEFAULT_TIMING
    if config.buffer == "rc":
        circuit, timing = with_rc_buffer(circuit, code, timing, config.margin)
    return PowerBus(code, rng, circuit, timing)


@dataclasses.dataclass(frozen=True)
class BusTrial:
    """Fates of the words of one trial.

    Attributes:
        config: Settings of the trial.
        fates: Number of words by fate, of `FATES`.
        resent: Number of trains sent again.
        rewritten: Number of words written again.
        seconds: (words,) time of each word on the line [s].
        wrong_bits: (words,) number of wrong bits after each word.
    """

    config: BusTrialConfig
    fates: dict[str, int]
    resent: int
    rewritten: int
    seconds: FloatArray
    wrong_bits: NDArray[np.int64]

    @property
    def sent(self) -> int:
        """Number of words sent."""
        return self.config.words

    @property
    def wrong(self) -> int:
        """Number of words that are not right at the end, reported or not."""
        return self.sent - self.fates["right"]

    @property
    def silent(self) -> int:
        """Number of words that are not right at the end, unknown to the master."""
        return self.wrong - self.fates["told"]


def run_trial(config: BusTrialConfig) -> BusTrial:
    """Send random words."""
    rng = np.random.default_rng(config.seed)
    protocol, bus = protocols(ACTUATORS)[config.protocol], build_bus(config, rng)
    rates = random_faults(rng, config.missed, config.extra, config.missed_flag)
    master = BusMaster(protocol, bus, rates)
    fates: dict[str, int] = dict.fromkeys(FATES, 0)
    resent = rewritten = 0
    seconds, wrong_bits = np.zeros(config.words), np.zeros(config.words, np.int64)
    start = np.zeros(ACTUATORS, bool)
    for index in range(config.words):
        goal = rng.random(ACTUATORS) < 0.5
        if not config.lasting:
            if index % REDRAW == REDRAW - 1:
                bus = build_bus(config, rng)
                master = BusMaster(protocol, bus, rates)
            start = rng.random(ACTUATORS) < 0.5
            # A word must change for a fault to befall it.
            goal[0] ^= np.array_equal(start, goal)
            if config.fault != "none":
                master = BusMaster(protocol, bus, one_fault(config.fault, bus, start, goal, rng))
            bus.preset(start)
            master.believe(start)
        outcome = master.change(goal)
        fates[_fate(bus.word, start, goal, outcome)] += 1
        resent, rewritten = resent + outcome.resent, rewritten + outcome.rewritten
        seconds[index] = outcome.seconds
        wrong_bits[index] = np.count_nonzero(bus.word != goal)
        start = goal
    return BusTrial(config, fates, resent, rewritten, seconds, wrong_bits)


def one_fault(
    kind: str,
    bus: PowerBus,
    start: NDArray[np.bool_],
    goal: NDArray[np.bool_],
    rng: np.random.Generator,
) -> Disturbance:
    """Return a fault at a random pulse or flag of those that the word change needs.

    Raises:
        ValueError: If there is no such kind of fault.
    """
    protocol = next(p for p in protocols(ACTUATORS).values() if p.code == bus.code)
    commands = planned_commands(protocol, bus, start, goal)
    pulses = sum(bus.code.pulses(command) for command in commands)
    return OneFault(kind, int(rng.integers(len(commands) if kind == "missed_flag" else pulses)))


def _fate(
    word: NDArray[np.bool_],
    start: NDArray[np.bool_],
    goal: NDArray[np.bool_],
    outcome: ChangeOutcome,
) -> str:
    if np.array_equal(word, goal):
        return "right"
    if outcome.failed:
        return "told"
    wrong = word != goal
    return "wrong" if np.any(wrong & (start == goal)) else "skipped"
