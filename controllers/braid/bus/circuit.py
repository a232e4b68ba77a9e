r"""The power line and the decoder chips on it, sampled (E.4, figures E-7 and E-8).

    line -> divider -> signal -> debounce -> counter -> buffer -> decoding -> latch
                          \-> 2.5:1 divider -> debounce -> clock of the buffer

The thesis prints the levels of the signal (2 V address pulses, 5 V flag), the 2.5:1 divider and
the TTL threshold (1.3 V). What it leaves open is decided here:

- A divider alone would pass the supply itself and hold the counter's input high. So a capacitor
  couples the line to the divider, and a clamp diode keeps a long train from shifting the level.
- The debouncer is an RC low-pass with a Schmitt trigger around the threshold; so is the flag's.
- The flag passes the counter's threshold too, and before the buffer's: it is counted, and the
  decoding takes one off. A flag alone means nothing.
- The buffer takes the count when the flag rises; the latch follows at once, and the counter is
  cleared when the flag falls. Without that a missed pulse would shift all that follows.
- The counter wraps.
- In the RC variant the first counted pulse starts to charge the capacitor; when it reaches the
  threshold, after t = -RC ln(1 - V_th / V) (the thesis' 0.63 RC is not that), the count is taken
  and cleared, and the capacitor is discharged.

Each chip has its own component values, so that chips can disagree.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.braid.bus.code import (
    DEFAULT_TIMING,
    AddressCode,
    BoolArray,
    PulseTiming,
    check_word,
)
from controllers.braid.bus.kernel import LATCH, REFUSED, UPPER, run_chips
from controllers.braid.bus.trains import Train, sampled_segments

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class BusCircuit:
    """Component values of line and decoders.

    Attributes:
        address_signal: Peak of address pulses behind the first divider [V]. Thesis: 2.
        flag_signal: Peak of the flag there [V]. Thesis: 5.
        buffer_divider: From the signal to the flag's detector. Thesis: 2.5.
        threshold: Of the logic [V]. Thesis: 1.3 (TTL).
        supply: Of the line at rest [V]. Assumed, as all that follows.
        signal_divider: From the line to the signal; the master's pulses are this much higher.
        hysteresis: Between the Schmitt trigger's two thresholds [V].
        debounce: Time constant of the debouncers [s].
        edge: Time constant of the line's edges [s].
        coupling: Time constant of the coupling capacitor [s].
        clamp: The same while the clamp diode conducts [s].
        clamp_drop: Of the clamp diode [V].
        actuator_current: Through one actuator that is on [A].
        line_resistance: Of supply and line, which the actuators' current drops at [ohm].
        logic_supply: Of the decoders [V].
        rc_time: R C of the RC buffer [s]; None for the buffer with the flag.
        divider_spread: Relative standard deviation of dividers from chip to chip.
        threshold_spread: Standard deviation of thresholds from chip to chip [V].
        rc_spread: Relative standard deviation of the RC buffer's time from chip to chip.
        noise: On the signal, standard deviation of each sample, all chips alike [V].
        sense_noise: Of the master's measurement of the supply current, standard deviation [A].
        sample: Time of one sample [s].
    """

    address_signal: float = 2.0
    flag_signal: float = 5.0
    buffer_divider: float = 2.5
    threshold: float = 1.3
    supply: float = 12.0
    signal_divider: float = 2.0
    hysteresis: float = 0.4
    debounce: float = 5e-6
    edge: float = 3e-6
    coupling: float = 0.2
    clamp: float = 1e-4
    clamp_drop: float = 0.3
    actuator_current: float = 0.2
    line_resistance: float = 0.1
    logic_supply: float = 5.0
    rc_time: float | None = None
    divider_spread: float = 0.01
    threshold_spread: float = 0.03
    rc_spread: float = 0.05
    noise: float = 0.0
    sense_noise: float = 0.02
    sample: float = 5e-6

    def __post_init__(self) -> None:
        """Refuse values that no component has.

        Raises:
            ValueError: If a value is not positive or a spread or noise negative.
        """
        free = {"divider_spread", "threshold_spread", "rc_spread", "noise", "sense_noise"}
        free |= {"hysteresis", "line_resistance", "actuator_current", "clamp_drop"}
        for field in dataclasses.fields(self):
            value, may_vanish = getattr(self, field.name), field.name in free
            if value is None:
                continue
            if not (math.isfinite(value) and (value > 0.0 or may_vanish and value == 0.0)):
                kind = "0 or more" if may_vanish else "a positive number"
                raise ValueError(f"{field.name}: expected {kind}, got {value}")
        if self.threshold + self.hysteresis / 2 >= self.logic_supply:
            raise ValueError(
                f"threshold: expected below the logic supply, got {self.threshold} V with a "
                f"hysteresis of {self.hysteresis} V at {self.logic_supply} V"
            )


def rc_delay(rc_time: float, threshold: float, supply: float) -> float:
    """Return the time in which an RC circuit charges to a threshold [s].

    Args:
        rc_time: R C [s].
        threshold: To be reached [V].
        supply: That it charges from [V].
    """
    return -rc_time * math.log(1.0 - threshold / supply)


def with_rc_buffer(
    circuit: BusCircuit, code: AddressCode, timing: PulseTiming, margin: float
) -> tuple[BusCircuit, PulseTiming]:
    """Return circuit and timing for the RC buffer in place of the flag.

    The delay is the margin times the longest train, from its first pulse, so that no chip takes
    the count before the train has ended; the master waits as much longer again for the slowest.

    Args:
        circuit: To take all else from.
        code: Its longest train sets the delay.
        timing: Of the pulses.
        margin: More than 1, by a few times ``rc_spread``.

    Raises:
        ValueError: If the margin is not above 1.
    """
    if margin <= 1.0:
        raise ValueError(f"margin: expected more than 1, got {margin}")
    longest = code.pulses(code.commands) * timing.period
    delay = margin * longest
    rc_time = delay / rc_delay(1.0, circuit.threshold, circuit.logic_supply)
    quiet = delay * margin + timing.gap
    return (
        dataclasses.replace(circuit, rc_time=rc_time),
        dataclasses.replace(timing, quiet=quiet),
    )


@dataclasses.dataclass(frozen=True)
class Trace:
    """What an oscilloscope sees, at the first chip.

    Attributes:
        time: (k,) [s].
        line: (k,) voltage of the power line [V].
        signal: (k,) behind the first divider [V].
        debounced: (k,) into the counter's trigger [V].
        flag: (k,) into the buffer's trigger [V].
        count: (k,) the counter.
        words: (k, n) what the latches hold.
    """

    time: FloatArray
    line: FloatArray
    signal: FloatArray
    debounced: FloatArray
    flag: FloatArray
    count: NDArray[np.int64]
    words: BoolArray


class PowerBus:
    """A power line with one decoder for each actuator."""

    def __init__(
        self,
        code: AddressCode,
        rng: np.random.Generator,
        circuit: BusCircuit | None = None,
        timing: PulseTiming = DEFAULT_TIMING,
    ) -> None:
        """Draw the chips' component values and switch all actuators off.

        Args:
            code: Wired into every decoder.
            rng: For component values and noise.
            circuit: Nominal values.
            timing: Of the master.

        Raises:
            ValueError: If circuit and timing mean different buffers.
        """
        self.code, self.timing = code, timing
        self.circuit = circuit = circuit or BusCircuit()
        if (circuit.rc_time is None) != (timing.quiet is None):
            raise ValueError("rc_time and quiet: give both for the RC buffer, or none for the flag")
        n = code.actuators
        self._rng = rng
        self._chips = _draw_chips(circuit, n, rng)
        self._line = np.zeros(2)
        self._voltages = np.zeros((3, n))
        self._waits, self._limits = np.ones((2, n)), np.vstack((self._chips[UPPER],) * 2)
        self._logic = np.zeros((3, n), np.int64)
        self._decoding = np.array(
            [
                code.spacing,
                code.tolerance,
                code.singles,
                code.commands,
                code.mode == "set",
                2**code.counter_bits,
                circuit.rc_time is not None,
            ],
            np.int64,
        )

    @property
    def word(self) -> BoolArray:
        """(n,) what the latches hold."""
        return self._logic[LATCH].astype(bool)

    @property
    def refused(self) -> NDArray[np.int64]:
        """(n,) how often each decoder saw a count that no command has."""
        return self._logic[REFUSED].copy()

    def preset(self, word: ArrayLike) -> None:
        """Bring all latches to a word, clear the counters and let the line settle."""
        states = check_word(self.code, word)
        self._logic[:] = 0
        self._logic[LATCH] = states
        self._voltages[:], self._waits[:], self._limits[:] = 0.0, 1.0, self._chips[UPPER]
        drop = self.circuit.line_resistance * self.circuit.actuator_current * states.sum()
        self._line[:] = -drop

    def send(self, trains: Sequence[Train]) -> BoolArray:
        """Put trains on the line.

        Returns:
            (m, n) the latches after each train.
        """
        return self._run(trains, np.zeros((0, 5)), np.zeros((0, 0), np.bool_))

    def observe(self, trains: Sequence[Train]) -> Trace:
        """Put trains on the line and return what an oscilloscope sees."""
        _, lengths, _ = sampled_segments(trains, self.timing, self.circuit.sample)
        count = int(lengths.sum())
        rows, words = np.zeros((count, 5)), np.zeros((count, self.code.actuators), np.bool_)
        self._run(trains, rows, words)
        time = self.circuit.sample * np.arange(1, count + 1, dtype=np.float64)
        line = self.circuit.supply + rows[:, 0]
        signal, debounced, flag = rows[:, 1], rows[:, 2], rows[:, 3]
        return Trace(time, line, signal, debounced, flag, rows[:, 4].astype(np.int64), words)

    def sense(self) -> int:
        """Return the number of actuators that are on, as the supply current tells the master.

        Raises:
            ValueError: If actuators that are on take no current.
        """
        circuit = self.circuit
        if circuit.actuator_current == 0.0:
            raise ValueError("actuator_current: expected a positive number to sense, got 0.0")
        current = circuit.actuator_current * self._logic[LATCH].sum()
        current += circuit.sense_noise * self._rng.standard_normal()
        return round(current / circuit.actuator_current)

    def _run(self, trains: Sequence[Train], rows: FloatArray, trace_words: BoolArray) -> BoolArray:
        levels, lengths, starts = sampled_segments(trains, self.timing, self.circuit.sample)
        circuit = self.circuit
        volts = np.array([0.0, circuit.address_signal, circuit.flag_signal])
        rises = volts[levels.astype(int)] * circuit.signal_divider
        words = np.zeros((len(trains), self.code.actuators), np.bool_)
        run_chips(
            rises,
            lengths,
            starts,
            _line_values(circuit),
            self._chips,
            self._decoding,
            self._line,
            self._voltages,
            self._waits,
            self._limits,
            self._logic,
            self._rng,
            words,
            rows,
            trace_words,
        )
        return words


def _smoothing(sample: float, time: float | FloatArray) -> FloatArray:
    """Return the share of a step that a first-order lag takes in one sample."""
    return -np.expm1(-sample / np.asarray(time, dtype=np.float64))


def _line_values(circuit: BusCircuit) -> FloatArray:
    """Return (10,) what the kernel needs of the line."""
    return np.array(
        [
            float(_smoothing(circuit.sample, circuit.edge)),
            float(_smoothing(circuit.sample, circuit.coupling)),
            float(_smoothing(circuit.sample, circuit.clamp)),
            circuit.clamp_drop,
            circuit.signal_divider,
            circuit.line_resistance * circuit.actuator_current,
            circuit.noise,
            float(_smoothing(circuit.sample, circuit.debounce)),
            circuit.logic_supply,
            circuit.threshold,
        ]
    )


def _draw_chips(circuit: BusCircuit, n: int, rng: np.random.Generator) -> FloatArray:
    """Return (5, n) component values: two gains, two thresholds, and the RC buffer's lag."""
    spread = circuit.divider_spread * rng.standard_normal((2, n))
    middle = circuit.threshold + circuit.threshold_spread * rng.standard_normal(n)
    slow = np.exp(circuit.rc_spread * rng.standard_normal(n))
    rc_time = math.inf if circuit.rc_time is None else circuit.rc_time
    return np.vstack(
        (
            1.0 + spread[0],
            (1.0 + spread[1]) / circuit.buffer_divider,
            middle + circuit.hysteresis / 2,
            middle - circuit.hysteresis / 2,
            _smoothing(circuit.sample, rc_time * slow),
        )
    )
