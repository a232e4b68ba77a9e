"""The master's side: protocols that live with missed and extra pulses (E.4).

The thesis sends each train once and hears nothing back. One missed pulse then toggles the wrong
actuator and skips the right one, and no one knows. Three protocols do better:

- "parity": odd addresses, and after each train the master measures the supply current, which
  shows how many actuators are on. Nothing changed: the train was refused, and is sent again. The
  current is wrong in another way: all are switched off (or on) and the word is written anew. If
  that fails too often, the fault is reported.
  Two faults in one train can still make another address and the expected current.
- "repeat": without any feedback. Trains set instead of toggle, odd addresses refuse what is
  damaged, and the whole sequence is sent twice; a lone train thrice, since a missed flag spoils
  the train that follows as well. It must not use broadcasts: the second round would first undo the
  word, and a fault after that would not be mended.
- "correct": addresses four apart; each decoder mends one missed or extra pulse in a train.
"""

import dataclasses
from collections.abc import Callable, Iterable

from numpy.typing import ArrayLike

from controllers.braid.bus.circuit import PowerBus
from controllers.braid.bus.code import (
    AddressCode,
    check_word,
    rewriting_commands,
    shortest_commands,
)
from controllers.braid.bus.trains import Disturbance, Train, trains_of
from perception.geometry.arrays import BoolArray


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How the master brings a word to the actuators.

    Attributes:
        code: Meaning of the trains; all decoders are wired for it.
        rounds: Number of times that the whole sequence is sent.
        verify: Whether the supply current is measured after each train.
        attempts: Greatest number of times that a train is sent, or a word written anew, with
            ``verify``.
    """

    code: AddressCode
    rounds: int = 1
    verify: bool = False
    attempts: int = 4

    def __post_init__(self) -> None:
        """Refuse what would not be safe.

        Raises:
            ValueError: If a number is out of range, or toggles or broadcasts would be repeated.
        """
        for name in ("rounds", "attempts"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected 1 or more, got {getattr(self, name)}")
        if self.rounds > 1 and (self.code.mode == "toggle" or self.code.broadcast):
            raise ValueError("rounds: only a code that sets, without broadcasts, may be repeated")
        if self.verify and (self.rounds > 1 or not self.code.broadcast):
            raise ValueError("verify: expected a code with broadcasts, sent in one round")


def protocols(actuators: int) -> dict[str, Protocol]:
    """Return the thesis' protocol and the three that withstand faults, by name."""
    return {
        "thesis": Protocol(AddressCode(actuators)),
        "parity": Protocol(AddressCode(actuators, spacing=2, broadcast=True), verify=True),
        "repeat": Protocol(AddressCode(actuators, mode="set", spacing=2), rounds=2),
        "correct": Protocol(AddressCode(actuators, spacing=4, tolerance=1)),
    }


@dataclasses.dataclass(frozen=True)
class ChangeOutcome:
    """Knowledge of the master after a change of word.

    Attributes:
        believed: (n,) the word that it takes the actuators to hold.
        failed: Whether the master gave up; then the word is unknown.
        resent: Trains sent again.
        rewritten: Number of times that the word was written anew.
        seconds: Time on the line [s].
    """

    believed: BoolArray
    failed: bool
    resent: int
    rewritten: int
    seconds: float


def planned_commands(
    protocol: Protocol, bus: PowerBus, start: ArrayLike, goal: ArrayLike
) -> tuple[int, ...]:
    """Return all commands that the master sends if nothing goes wrong."""
    once = shortest_commands(protocol.code, start, goal, bus.timing)
    rounds = protocol.rounds
    if rounds > 1 and len(once) == 1:
        rounds += 1
    return once * rounds


class BusMaster:
    """Sends words over a bus by a protocol, and believes what it has been able to check."""

    def __init__(
        self, protocol: Protocol, bus: PowerBus, disturb: Disturbance | None = None
    ) -> None:
        """Take a bus whose actuators are all off.

        Args:
            protocol: Protocol that says what is sent and checked.
            bus: The line with its decoders.
            disturb: Fault on each train on the line, unknown to the master.

        Raises:
            ValueError: If the bus is wired for another code.
        """
        if bus.code != protocol.code:
            raise ValueError(f"bus: wired for {bus.code}, but the protocol has {protocol.code}")
        self._protocol, self._bus = protocol, bus
        self._disturb: Callable[[Train], Train] = disturb or (lambda train: train)
        self._believed = check_word(protocol.code, [0] * protocol.code.actuators)
        self._lost = False

    def believe(self, word: ArrayLike) -> None:
        """Set the word that the actuators are known to hold."""
        self._believed = check_word(self._protocol.code, word)
        self._lost = False

    def change(self, goal: ArrayLike) -> ChangeOutcome:
        """Bring the actuators to a word; one that follows a failure is written anew.

        Raises:
            ValueError: If the word has not one state for each actuator.
        """
        goal = check_word(self._protocol.code, goal)
        self._resent, self._rewritten, self._seconds = 0, 0, 0.0
        if self._protocol.verify:
            self._lost = not self._write_and_verify(goal)
        else:
            self._send(planned_commands(self._protocol, self._bus, self._believed, goal))
            self._believed = goal
        return ChangeOutcome(
            self._believed, self._lost, self._resent, self._rewritten, self._seconds
        )

    def _send(self, commands: Iterable[int]) -> None:
        trains = trains_of(self._protocol.code, commands)
        self._seconds += sum(self._bus.timing.seconds(len(train.pulses)) for train in trains)
        if trains:
            self._bus.send([self._disturb(train) for train in trains])

    def _write_and_verify(self, goal: BoolArray) -> bool:
        """Send the shortest sequence and, if it goes wrong, write the word anew."""
        code, timing = self._protocol.code, self._bus.timing
        commands = (
            rewriting_commands(code, goal, timing)
            if self._lost
            else shortest_commands(code, self._believed, goal, timing)
        )
        for _ in range(self._protocol.attempts):
            if all(self._obeyed(command) for command in commands):
                return True
            self._rewritten += 1
            commands = rewriting_commands(code, goal, timing)
        return False

    def _obeyed(self, command: int) -> bool:
        """Send one train, again if it was refused; whether the current then is as expected."""
        code, before = self._protocol.code, int(self._believed.sum())
        after = code.obey(self._believed, command)
        broadcast = command > code.singles
        for attempt in range(self._protocol.attempts):
            self._resent += attempt > 0
            self._send((command,))
            seen = self._bus.sense()
            if seen == int(after.sum()):
                self._believed = after
                return True
            # After a broadcast nothing needs to be known of what was before.
            if seen != before and not broadcast:
                return False
        return False
