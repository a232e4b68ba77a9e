"""Addresses as numbers of pulses, and the shortest pulse trains for a change of word (E.4).

A train is p address pulses and the end-of-train flag. The commands of a bus are numbered from 1.
Command k is p = s k - floor(s/2) pulses with a spacing of s, and counts within the tolerance t of
it are taken for it. The thesis' addresses are s = 1, t = 0: every count is somebody's address, so
a missed pulse always triggers the wrong actuator or none. With s = 2 every address is odd: one
missed or extra pulse makes an even count, which no decoder answers, and so do two trains that
merge because the flag between them is missed. With s = 4, t = 1 one missed or extra pulse in a
train is corrected, and two, or a missed flag, still fall between the addresses.

The thesis leaves open whether a train toggles an actuator or sets it ("the actuator that requires
toggling", "triggered into either binary state"); both are here.
"""

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from controllers.braid.bus.decoder_chips import Decoding
from perception.geometry.arrays import BoolArray


@dataclasses.dataclass(frozen=True)
class AddressCode:
    """Meaning of each number of pulses.

    In mode "toggle", command i + 1 toggles actuator i. In mode "set", command 2 i + 1 switches
    actuator i on and 2 i + 2 off, so that a train may be repeated. With ``broadcast`` two commands
    follow that every actuator obeys: all off (home), and all on. They have the longest trains, so
    that noise hardly makes one.

    Attributes:
        actuators: Number of actuators n; three for each stage.
        mode: Effect of a train on its actuator.
        spacing: Pulses s between neighbouring addresses.
        tolerance: Counts t to either side of an address that still mean it.
        broadcast: Whether there are commands for all actuators.
    """

    actuators: int
    mode: Literal["toggle", "set"] = "toggle"
    spacing: int = 1
    tolerance: int = 0
    broadcast: bool = False

    def __post_init__(self) -> None:
        """Refuse addresses that overlap.

        Raises:
            ValueError: If a number is out of range or the mode unknown.
        """
        if self.actuators < 1:
            raise ValueError(f"actuators: expected 1 or more, got {self.actuators}")
        if self.mode not in ("toggle", "set"):
            raise ValueError(f"mode {self.mode!r}: expected 'toggle' or 'set'")
        if self.spacing < 1:
            raise ValueError(f"spacing: expected 1 or more, got {self.spacing}")
        most = (self.spacing - 1) // 2
        if not 0 <= self.tolerance <= most:
            raise ValueError(
                f"tolerance: expected 0 to {most} at a spacing of {self.spacing}, "
                f"got {self.tolerance}"
            )

    @property
    def singles(self) -> int:
        """Number of commands for one actuator."""
        return self.actuators if self.mode == "toggle" else 2 * self.actuators

    @property
    def commands(self) -> int:
        """Number of commands; they are 1 to this."""
        return self.singles + 2 * self.broadcast

    @property
    def home(self) -> int:
        """The command that switches all off.

        Raises:
            ValueError: If the code has none.
        """
        if not self.broadcast:
            raise ValueError("home: this code has no broadcast commands")
        return self.singles + 1

    @property
    def counter_bits(self) -> int:
        """Width of the counter: it holds the longest train, its flag and the tolerance."""
        return (self.pulses(self.commands) + 1 + self.tolerance).bit_length()

    def pulses(self, command: int) -> int:
        """Return the number of address pulses of a command.

        Raises:
            ValueError: If there is no such command.
        """
        if not 1 <= command <= self.commands:
            raise ValueError(f"command {command}: expected 1 to {self.commands}")
        return self.spacing * command - self.spacing // 2

    def decoding(self, rc_buffer: bool = False) -> Decoding:
        """Return what is wired into the decoder chips, for `decoder_chips`.

        Args:
            rc_buffer: Whether the RC buffer takes the count rather than the flag.
        """
        return Decoding(
            self.spacing,
            self.tolerance,
            self.singles,
            self.commands,
            int(self.mode == "set"),
            2**self.counter_bits,
            int(rc_buffer),
        )

    def obey(self, word: ArrayLike, command: int) -> BoolArray:
        """Return the word after a command.

        Args:
            word: (n,) states of the actuators.
            command: 0 for none, or 1 to `commands`.
        """
        after = check_word(self, word).copy()
        if command > self.singles:
            after[:] = command == self.singles + 2
        elif command > 0 and self.mode == "toggle":
            after[command - 1] ^= True
        elif command > 0:
            after[(command - 1) // 2] = command % 2 == 1
        return after

    def single(self, actuator: int, state: bool) -> int:
        """Return the command that brings an actuator from the other state to this one."""
        return actuator + 1 if self.mode == "toggle" else 2 * actuator + 2 - int(state)


@dataclasses.dataclass(frozen=True)
class PulseTiming:
    """How the master times its pulses; the thesis prints none of it.

    Attributes:
        period: Time from pulse to pulse [s].
        high: Length of a pulse [s].
        flag: Length of the end-of-train flag [s].
        gap: Rest after the flag, for the counters to be cleared [s].
        quiet: Time from the start of a train until the next may start [s], with the RC buffer,
            which needs no flag. None where flags end the trains.
    """

    period: float = 100e-6
    high: float = 50e-6
    flag: float = 100e-6
    gap: float = 100e-6
    quiet: float | None = None

    def __post_init__(self) -> None:
        """Refuse times that cannot be.

        Raises:
            ValueError: If a time is not positive or a pulse longer than its period.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not value > 0.0:
                raise ValueError(f"{field.name}: expected a positive time, got {value}")
        if self.high >= self.period:
            raise ValueError(f"high: expected less than the period {self.period}, got {self.high}")

    def seconds(self, pulses: int) -> float:
        """Return how long a train takes until the next may start [s]."""
        if self.quiet is not None:
            return self.quiet
        return pulses * self.period + self.flag + self.gap


DEFAULT_TIMING = PulseTiming()


def duration(code: AddressCode, commands: ArrayLike, timing: PulseTiming = DEFAULT_TIMING) -> float:
    """Return how long a sequence of commands takes on the line [s].

    Raises:
        ValueError: If there is no such command.
    """
    numbers = np.atleast_1d(np.asarray(commands, dtype=int))
    return float(sum(timing.seconds(code.pulses(int(number))) for number in numbers))


def shortest_commands(
    code: AddressCode,
    start: ArrayLike,
    goal: ArrayLike,
    timing: PulseTiming = DEFAULT_TIMING,
) -> tuple[int, ...]:
    """Return the commands that take the least time from one word to another.

    All that comes before the last broadcast is wasted, so a shortest sequence is at most one
    broadcast and then a command for each actuator that still differs. One cannot do with fewer
    than these: a command changes one actuator, and each has one command that changes it.
    Commands for single actuators may come in any order; here the longest trains come first.

    Args:
        code: Meaning of the trains.
        start: (n,) word that the actuators hold.
        goal: (n,) word that the actuators shall hold.
        timing: Timing of the pulses, which decides what a train costs.

    Returns:
        Commands in the order in which to send them; none if the words are equal.

    Raises:
        ValueError: If a word has not one state for each actuator.
    """
    start, goal = check_word(code, start), check_word(code, goal)
    sequences = [_differences(code, start, goal)]
    if code.broadcast:
        sequences += _after_broadcasts(code, goal)
    return min(sequences, key=lambda commands: duration(code, commands, timing))


def rewriting_commands(
    code: AddressCode, goal: ArrayLike, timing: PulseTiming = DEFAULT_TIMING
) -> tuple[int, ...]:
    """Return commands that bring every word to the goal: what is done after a fault.

    Args:
        code: Meaning of the trains.
        goal: (n,) word that the actuators shall hold.
        timing: Timing of the pulses, which decides what a train costs.

    Raises:
        ValueError: If the code has no broadcasts.
    """
    sequences = _after_broadcasts(code, check_word(code, goal))
    return min(sequences, key=lambda commands: duration(code, commands, timing))


def _after_broadcasts(code: AddressCode, goal: BoolArray) -> list[tuple[int, ...]]:
    """Return the sequences that begin with all off and with all on."""
    return [
        (command, *_differences(code, np.full_like(goal, state), goal))
        for command, state in ((code.home, False), (code.home + 1, True))
    ]


def check_word(code: AddressCode, word: ArrayLike) -> BoolArray:
    """Return a word as (n,) booleans.

    Raises:
        ValueError: If it has not one state, 0 or 1, for each actuator.
    """
    states = np.asarray(word)
    if states.shape != (code.actuators,) or not np.all((states == 0) | (states == 1)):
        raise ValueError(f"word {states.tolist()}: expected {code.actuators} states of 0 or 1")
    return states.astype(bool)


def _differences(code: AddressCode, start: BoolArray, goal: BoolArray) -> tuple[int, ...]:
    """Return one command for each actuator that differs, the longest train first."""
    singles = [code.single(int(i), bool(goal[i])) for i in np.flatnonzero(start != goal)]
    return tuple(sorted(singles, reverse=True))
