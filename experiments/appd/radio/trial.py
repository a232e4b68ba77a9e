"""One trial of ``appd-radio``: messages one way over an emulated radio, in virtual time."""

import dataclasses
import math
from collections import Counter

import numpy as np

from experiments.harness.intervals import Distribution
from perception.geometry.arrays import FloatArray
from twin.hardware.emulator.modem import ModemConfig, VirtualModems
from twin.hardware.radio.channel import BITS_PER_BYTE
from twin.hardware.radio.framed_radio import FramedLink
from twin.hardware.radio.handshake import HandshakeConfig, HandshakeLink

LINKS = ("handshake", "framed")
FATES = ("intact", "wrong", "vanished", "given_up")
_PENDING = {"handshake": 1, "framed": 16}  # messages that wait in the link under full load
_DRAIN = 1.0  # [s] after the last outcome, for what is still on its way


@dataclasses.dataclass(frozen=True)
class TrialConfig:
    """What is sent over what.

    Attributes:
        link: Protocol, of `LINKS`.
        error_rate: Probability that a byte is changed, lost or preceded by another one.
        delay: One-way delay of the modems [s].
        messages: Number of messages.
        seed: Random seed of the messages and the errors.
        size: Size of a message, a pose [bytes].
        period: Time between messages [s]; 0 sends as fast as the link takes them.
        poll: Polling period of the hosts [s]; 0 lets them answer at once.
    """

    link: str
    error_rate: float
    delay: float
    messages: int
    seed: int
    size: int = 20
    period: float = 0.0
    poll: float = 0.0


def make_links(
    config: TrialConfig, modems: VirtualModems, rng: np.random.Generator
) -> tuple[HandshakeLink | FramedLink, HandshakeLink | FramedLink]:
    """Return both ends of the trial's link.

    The handshake's deadlines are as short as they can be, which favours it: 1.25 times the longest
    duration of a message without errors.
    """
    first, second = modems.ends
    if config.link == "framed":
        return FramedLink(first, rng), FramedLink(second, rng)
    size, waiting = config.size, config.delay + config.poll
    clean = (3 * size + 1) * BITS_PER_BYTE / ModemConfig.baud + 2 * size * waiting
    deadlines = HandshakeConfig(send_within=1.25 * clean, receive_within=1.1 * clean)
    return HandshakeLink(first, deadlines), HandshakeLink(second, deadlines)


class _LinkTrial:
    """Both hosts, their link, virtual time, and what became of messages that all differ."""

    def __init__(self, config: TrialConfig) -> None:
        self.sent: dict[bytes, int] = {}
        self.begun: list[float] = []
        self.arrived: dict[int, float] = {}
        self.wrong_at: list[float] = []
        self.stall_at: list[float] = []
        self.duplicates = self.disordered = 0
        self.finished = 0.0
        self._confirmed: dict[int, bool] = {}
        self._spoilt: set[int] = set()
        self._newest = self._concluded = -1
        self._config = config
        self._rng = np.random.default_rng(config.seed)
        modems = ModemConfig(delay=config.delay, error_rate=config.error_rate)
        self._modems = VirtualModems(modems, self._rng)
        self._sender, self._receiver = make_links(config, self._modems, self._rng)
        self._indices: dict[int, int] = {}  # by ticket

    def run(self) -> None:
        """Go on until all is sent and nothing happens any more."""
        while True:
            while self._ready_at() <= self._modems.time:
                self._send()
            self._poll()
            ready = self._ready_at()
            event = min(
                self._modems.next_arrival(), self._sender.next_event(), self._receiver.next_event()
            )
            idle = ready == math.inf and not self._sender.pending
            if idle and (event == math.inf or event > self.finished + _DRAIN):
                return
            self._advance(min(event, ready))

    def _ready_at(self) -> float:
        """When the next message is there and the link has room for it [s]."""
        count = len(self.sent)
        busy = self._sender.pending >= _PENDING[self._config.link]
        if count >= self._config.messages or busy:
            return math.inf
        return count * self._config.period

    def _send(self) -> None:
        config = self._config
        message = self._rng.bytes(config.size)
        while message in self.sent:
            message = self._rng.bytes(config.size)
        index = self.sent[message] = len(self.sent)
        self.begun.append(index * config.period if config.period > 0.0 else self._modems.time)
        self._indices[self._sender.send(message)] = index

    def _poll(self) -> None:
        now = self._modems.time
        outcomes, messages = self._sender.poll().outcomes, list[bytes]()
        if min(self._modems.lines[0].next_arrival(), self._receiver.next_event()) <= now:
            messages = self._receiver.poll().messages
        for outcome in outcomes:
            self._concluded = self._indices[outcome.ticket]
            self._confirmed[self._concluded] = outcome.confirmed
            if not outcome.confirmed:
                self.stall_at.append(now)
        for message in messages:
            self._receive(message, now)
        if outcomes or messages:
            self.finished = now

    def _receive(self, message: bytes, now: float) -> None:
        """Count a message that the receiver was handed."""
        index = self.sent.get(message)
        if index is None:
            self.wrong_at.append(now)
            self._spoilt.add(self._suspect())
        elif index in self.arrived:
            self.duplicates += 1
        else:
            self.arrived[index] = now
            self.disordered += index < self._newest
            self._newest = max(index, self._newest)

    def _suspect(self) -> int:
        """Return which message must be the wrong one: the one just sent, if it is still out."""
        done = self._concluded
        if self._confirmed.get(done) and done not in self.arrived and done not in self._spoilt:
            return done
        return len(self.sent) - 1

    def fate(self, index: int) -> str:
        """Return how a message ended, one of `FATES`.

        Intact; wrong, without an error; vanished, though its arrival was confirmed; given up, and
        reported as such.
        """
        if index in self.arrived:
            return "intact"
        if index in self._spoilt:
            return "wrong"
        return "vanished" if self._confirmed.get(index) else "given_up"

    def _advance(self, event: float) -> None:
        """Go to an event, or to the hosts' next poll after it."""
        now, period = self._modems.time, self._config.poll
        if period > 0.0 and event > now:
            event = max(event, math.ceil(event / period - 1e-9) * period)
        self._modems.time = max(now, event)


@dataclasses.dataclass(frozen=True)
class RadioCounts:
    """What became of the messages of one link; `FATES` are the four counts that sum to all sent.

    Attributes:
        link: Protocol, of `LINKS`.
        error_rate: Probability that a byte is damaged.
        delay: One-way delay of the modems [s].
        sent: Number of messages.
        intact: Number of messages that arrived intact.
        wrong: Number of messages that arrived wrong, without an error.
        vanished: Number of messages that were confirmed but did not arrive.
        given_up: Number of messages reported as not confirmed that did not arrive.
        duplicates: Number of messages delivered twice.
        disordered: Number of messages delivered out of order.
        wrong_received: Number of deliveries that no one had sent.
        stalls: Number of messages reported as not confirmed.
        duration: Time until all was over [s].
    """

    link: str
    error_rate: float
    delay: float
    sent: int
    intact: int
    wrong: int
    vanished: int
    given_up: int
    duplicates: int
    disordered: int
    wrong_received: int
    stalls: int
    duration: float


@dataclasses.dataclass(frozen=True)
class RadioTrial(RadioCounts):
    """One trial.

    Attributes:
        goodput: Intact payload [bytes/s].
        latency: (m,) latency of the intact messages [s].
        arrival: (m,) when they arrived [s].
        wrong_at: (k,) when wrong messages were delivered [s].
        stall_at: (j,) when messages were reported as not confirmed [s].
    """

    goodput: float
    latency: FloatArray
    arrival: FloatArray
    wrong_at: FloatArray
    stall_at: FloatArray


@dataclasses.dataclass(frozen=True)
class PooledTrials(RadioCounts):
    """The trials of one link and error rate, counted together.

    Attributes:
        goodput: Distribution of the trials' intact payload [bytes/s].
    """

    goodput: Distribution


def run_trial(config: TrialConfig) -> RadioTrial:
    """Send all messages, and score what arrived; a job of the sweep."""
    trial = _LinkTrial(config)
    trial.run()
    fates = Counter(map(trial.fate, trial.sent.values()))
    arrival = np.array(list(trial.arrived.values()))
    begun = np.array([trial.begun[index] for index in trial.arrived])
    return RadioTrial(
        link=config.link,
        error_rate=config.error_rate,
        delay=config.delay,
        sent=len(trial.sent),
        **{fate: fates[fate] for fate in FATES},
        duplicates=trial.duplicates,
        disordered=trial.disordered,
        wrong_received=len(trial.wrong_at),
        stalls=len(trial.stall_at),
        duration=trial.finished,
        goodput=fates["intact"] * config.size / trial.finished,
        latency=arrival - begun,
        arrival=arrival,
        wrong_at=np.array(trial.wrong_at),
        stall_at=np.array(trial.stall_at),
    )
