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

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from controllers.braid.bus.code import DEFAULT_TIMING, AddressCode, PulseTiming, check_word
from controllers.braid.bus.decoder_chips import (
    BusModel,
    BusState,
    ChipValues,
    LinePieces,
    LineValues,
    Trace,
    run_chips,
)
from controllers.braid.bus.trains import Train, sampled_segments
from perception.geometry.arrays import BoolArray, FloatArray


@dataclasses.dataclass(frozen=True)
class BusCircuit:
    """Component values of line and decoders.

    Attributes:
        address_signal: Peak of address pulses behind the first divider [V]. Thesis: 2.
        flag_signal: Peak of the flag behind the first divider [V]. Thesis: 5.
        buffer_divider: Ratio of the signal to the flag detector's input. Thesis: 2.5.
        threshold: Threshold of the logic [V]. Thesis: 1.3 (TTL).
        supply: Voltage of the line at rest [V]. Assumed, as all that follows.
        signal_divider: Ratio of the line's voltage to the signal's.
        hysteresis: Difference between the Schmitt trigger's two thresholds [V].
        debounce: Time constant of the debouncers [s].
        edge: Time constant of the line's edges [s].
        coupling: Time constant of the coupling capacitor [s].
        clamp: Time constant of the coupling capacitor while the clamp diode conducts [s].
        clamp_drop: Voltage drop of the clamp diode [V].
        actuator_current: Current through one actuator that is on [A].
        line_resistance: Resistance of supply and line [ohm].
        logic_supply: Supply of the decoders [V].
        rc_time: Time constant R C of the RC buffer [s]; None for the buffer with the flag.
        divider_sigma: Relative standard deviation of dividers from chip to chip.
        threshold_sigma: Standard deviation of thresholds from chip to chip [V].
        rc_sigma: Relative standard deviation of the RC buffer's time from chip to chip.
        noise: Standard deviation of the signal's noise in each sample, the same for all chips [V].
        sense_noise: Standard deviation of the master's measurement of the supply current [A].
        sample: Time of one sample [s].

    Raises:
        ValueError: If a value is not positive, or a deviation or noise negative.
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
    divider_sigma: float = 0.01
    threshold_sigma: float = 0.03
    rc_sigma: float = 0.05
    noise: float = 0.0
    sense_noise: float = 0.02
    sample: float = 5e-6

    def __post_init__(self) -> None:
        free = {"divider_sigma", "threshold_sigma", "rc_sigma", "noise", "sense_noise"}
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
        threshold: Voltage to be reached [V].
        supply: Voltage that it charges from [V].
    """
    return -rc_time * math.log(1.0 - threshold / supply)


def with_rc_buffer(
    circuit: BusCircuit, code: AddressCode, timing: PulseTiming, margin: float
) -> tuple[BusCircuit, PulseTiming]:
    """Return circuit and timing for the RC buffer in place of the flag.

    The delay is the margin times the longest train, from its first pulse, so that no chip takes
    the count before the train has ended; the master waits as much longer again for the slowest.

    Args:
        circuit: Circuit that gives all other values.
        code: Address code, whose longest train sets the delay.
        timing: Timing of the pulses.
        margin: Ratio of the delay to the longest train: above 1 by a few times ``rc_sigma``.

    Raises:
        ValueError: If the margin is not above 1.
    """
    if margin <= 1.0:
        raise ValueError(f"margin: expected more than 1, got {margin}")
    delay = margin * (code.pulses(code.commands) * timing.period)
    rc_time = delay / rc_delay(1.0, circuit.threshold, circuit.logic_supply)
    quiet = delay * margin + timing.gap
    return (
        dataclasses.replace(circuit, rc_time=rc_time),
        dataclasses.replace(timing, quiet=quiet),
    )


class PowerBus:
    """A power line with one decoder for each actuator; all actuators are off at first.

    Args:
        code: Address code that is wired into every decoder.
        rng: Random generator for component values and noise.
        circuit: Nominal component values.
        timing: Timing of the master's pulses.

    Raises:
        ValueError: If circuit and timing mean different buffers.
    """

    def __init__(
        self,
        code: AddressCode,
        rng: np.random.Generator,
        circuit: BusCircuit | None = None,
        timing: PulseTiming = DEFAULT_TIMING,
    ) -> None:
        self.code, self.timing = code, timing
        self.circuit = circuit = circuit or BusCircuit()
        if (circuit.rc_time is None) != (timing.quiet is None):
            raise ValueError("rc_time and quiet: give both for the RC buffer, or none for the flag")
        n = code.actuators
        self._rng = rng
        chips = _draw_chips(circuit, n, rng)
        decoding = code.decoding(circuit.rc_time is not None)
        self._model = BusModel(_line_values(circuit), chips, decoding)
        voltages, waits, limits = np.zeros((2, n)), np.ones((2, n)), np.vstack((chips.upper,) * 2)
        counts, latches = np.zeros((2, n), np.int64)
        self._state = BusState(np.zeros(2), voltages, waits, limits, np.zeros(n), counts, latches)

    @property
    def word(self) -> BoolArray:
        """(n,) states of the latches."""
        return self._state.latches.astype(bool)

    def preset(self, word: ArrayLike) -> None:
        """Bring all latches to a word, clear the counters and let the line settle."""
        states = check_word(self.code, word)
        state = self._state
        state.latches[:] = states
        state.counts[:] = state.voltages[:] = state.capacitors[:] = 0
        state.waits[:], state.limits[:] = 1.0, self._model.chips.upper
        drop = self.circuit.line_resistance * self.circuit.actuator_current * states.sum()
        state.line[:] = -drop

    def send(self, trains: Sequence[Train]) -> BoolArray:
        """Put trains on the line.

        Returns:
            (m, n) the latches after each train.
        """
        return run_chips(self._pieces(trains), self._model, self._state, self._rng, self._trace(0))

    def observe(self, trains: Sequence[Train]) -> Trace:
        """Put trains on the line and return what an oscilloscope sees."""
        pieces = self._pieces(trains)
        trace = self._trace(int(pieces.lengths.sum()))
        run_chips(pieces, self._model, self._state, self._rng, trace)
        return trace._replace(line=self.circuit.supply + trace.line)

    def _trace(self, samples: int) -> Trace:
        """Return a trace of so many samples, to be filled."""
        time = self.circuit.sample * np.arange(1, samples + 1, dtype=np.float64)
        line, signal, debounced, flag = np.zeros((4, samples))
        counts, words = np.zeros(samples, np.int64), np.zeros((samples, self.code.actuators), bool)
        return Trace(time, line, signal, debounced, flag, counts, words)

    def sense(self) -> int:
        """Return the number of actuators that are on by a measurement of the supply current.

        Raises:
            ValueError: If actuators that are on take no current.
        """
        circuit = self.circuit
        if circuit.actuator_current == 0.0:
            raise ValueError("actuator_current: expected a positive number to sense, got 0.0")
        current = circuit.actuator_current * self._state.latches.sum()
        current += circuit.sense_noise * self._rng.standard_normal()
        return round(current / circuit.actuator_current)

    def _pieces(self, trains: Sequence[Train]) -> LinePieces:
        circuit = self.circuit
        levels, lengths, starts = sampled_segments(trains, self.timing, circuit.sample)
        volts = np.array([0.0, circuit.address_signal, circuit.flag_signal])
        return LinePieces(volts[levels.astype(int)] * circuit.signal_divider, lengths, starts)


def _smoothing(sample: float, time: float | FloatArray) -> FloatArray:
    """Return the share of a step that a first-order lag takes in one sample."""
    return -np.expm1(-sample / np.asarray(time, dtype=np.float64))


def _line_values(circuit: BusCircuit) -> LineValues:
    def share(time: float) -> float:
        return float(_smoothing(circuit.sample, time))

    return LineValues(
        edge=share(circuit.edge),
        coupling=share(circuit.coupling),
        clamp=share(circuit.clamp),
        clamp_drop=circuit.clamp_drop,
        divider=circuit.signal_divider,
        actuator_drop=circuit.line_resistance * circuit.actuator_current,
        noise=circuit.noise,
        debounce=share(circuit.debounce),
        logic_supply=circuit.logic_supply,
        rc_limit=circuit.threshold,
    )


def _draw_chips(circuit: BusCircuit, n: int, rng: np.random.Generator) -> ChipValues:
    """Draw the component values of n chips."""
    off = circuit.divider_sigma * rng.standard_normal((2, n))
    middle = circuit.threshold + circuit.threshold_sigma * rng.standard_normal(n)
    slow = np.exp(circuit.rc_sigma * rng.standard_normal(n))
    rc_time = math.inf if circuit.rc_time is None else circuit.rc_time
    return ChipValues(
        gains=np.vstack((1.0 + off[0], (1.0 + off[1]) / circuit.buffer_divider)),
        upper=middle + circuit.hysteresis / 2,
        lower=middle - circuit.hysteresis / 2,
        rc_lag=np.asarray(_smoothing(circuit.sample, rc_time * slow)),
    )
