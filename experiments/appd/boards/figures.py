"""Figures of ``appd-boards``."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.appd.boards.line import DamagedCalls
from experiments.appd.boards.live import LoopPace
from experiments.harness.figure_style import BLUE, ORANGE, RED
from models.datasheets import PULSE_CLOCK
from twin.hardware.emulator.amplifier import (
    AmplifierConfig,
    bridge_share,
    command_volts,
    current_limit,
    motor_current,
    motor_volts,
    pulse_share,
)

LAWS = {"linear": BLUE, "rc": ORANGE}
WHEEL, JOINT = 0, 4  # of the eight motors
_NEAR_ZERO = 160  # codes shown of the dead band
_LEAST_CALL = 0.05  # [ms]


def draw_stops(times: Mapping[str, Sequence[float]], bound: float) -> Figure:
    """Draw, for each fault, how long after it the last axis was driven.

    Args:
        times: Times to a stop by fault [s]; infinite ones are drawn beyond the bound.
        bound: Time by which all must have stopped [s].
    """
    figure = Figure(figsize=(9, 0.4 * len(times) + 1.5))
    axes = figure.add_subplot()
    for row, values in enumerate(times.values()):
        found = 1e3 * np.minimum(np.asarray(values, dtype=float), 1.3 * bound)
        # Ticks are discrete: separate points that would coincide.
        height = row + np.linspace(-0.25, 0.25, len(found))
        axes.plot(found, height, "o", markersize=4, alpha=0.7, color=BLUE)
        axes.plot([np.median(found)] * 2, [row - 0.35, row + 0.35], color=RED)
    axes.axvline(1e3 * bound, color="k", linestyle="--", label="timeout and one cycle")
    axes.plot([], [], color=RED, label="median")
    axes.set_yticks(range(len(times)), [name.replace("_", " ") for name in times])
    axes.set(xlabel="from the fault to zero at all eight motors [ms]", xlim=(-5, 1400 * bound))
    axes.invert_yaxis()
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    return figure


def draw_calls(results: Sequence[DamagedCalls], bound: float) -> Figure:
    """Draw the share of calls that took longer than a time, for each rate of damage.

    Args:
        results: Calls by rate of damage.
        bound: Bound on the longest call [ms].
    """
    figure = Figure(figsize=(8, 4))
    axes = figure.add_subplot()
    for result in results:
        calls = np.maximum(np.sort(result.call_ms), _LEAST_CALL)
        longer = 1.0 - np.arange(calls.size) / calls.size
        axes.step(calls, longer, where="post", label=f"{100 * result.rate:g} % damaged")
    axes.axvline(bound, color="k", linestyle="--", label="bound")
    axes.set(
        xscale="log", yscale="log", xlabel="call of the bus [ms]", ylabel="share of longer ones"
    )
    axes.legend()
    axes.grid(alpha=0.3, which="both")
    return figure


def draw_pace(result: LoopPace, period: float) -> Figure:
    """Draw the distribution of the loop's period and of the adapter's time in a cycle.

    Args:
        result: Pace of the loop on the wall clock.
        period: Wanted [s].
    """
    figure = Figure(figsize=(10, 4))
    left, right = figure.subplots(1, 2)
    periods, adapter = 1e3 * result.periods, 1e3 * result.adapter
    for axes, values, label in (
        (left, periods, "from cycle to cycle [ms]"),
        (right, adapter, "adapter in a cycle [ms]"),
    ):
        edges = np.linspace(0.0, max(3e3 * period, float(np.percentile(values, 99.9))), 91)
        axes.hist(np.minimum(values, edges[-1]), edges, color=BLUE)
        axes.axvline(1e3 * period, color="k", linestyle="--", linewidth=0.8)
        axes.set(xlabel=f"{label}; last bar: longer", ylabel="cycles", yscale="log")
        axes.grid(alpha=0.3)
    left.set_title(f"{result.misses} deadlines missed in {result.steps} cycles")
    right.set_title(f"mean {adapter.mean():.2f} ms")
    figure.tight_layout()
    return figure


def draw_amplifier() -> Figure:
    """Draw what the amplifier card makes of a command (Thesis figure D-3)."""
    figure = Figure(figsize=(11, 8))
    grid = figure.subplots(2, 2)
    _draw_duty(grid[0, 0])
    _draw_frequency(grid[0, 1])
    _draw_dead_band(grid[1, 0])
    _draw_currents(grid[1, 1])
    for axes in grid.ravel():
        axes.grid(alpha=0.3)
        axes.legend()
    figure.tight_layout()
    return figure


def _draw_duty(axes: Axes) -> None:
    for law, colour in LAWS.items():
        card = AmplifierConfig(law=law)  # pyright: ignore[reportArgumentType]
        volts = command_volts(np.arange(card.full_code + 1), card)
        axes.plot(volts, bridge_share(pulse_share(volts, card), card), color=colour, label=law)
    axes.set(xlabel="command [V]", ylabel="duty at the bridge [-]", title="duty")


def _draw_frequency(axes: Axes) -> None:
    capacitances = np.geomspace(0.2e-9, 10e-9, 60)
    cards = [AmplifierConfig(capacitance=float(value)) for value in capacitances]
    axes.loglog(1e9 * capacitances, [1e-3 * card.clock_frequency for card in cards], label="clock")
    card = AmplifierConfig()
    label = f"{1e-3 * card.clock_frequency:.1f} kHz, high for {100 * card.clock_duty:.1f} %"
    axes.plot(1e9 * card.capacitance, 1e-3 * card.clock_frequency, "o", label=label)
    title = f"frequency, {card.resistance_a / 1e3:g} and {card.resistance_b / 1e3:g} kOhm"
    axes.set(xlabel="capacitor of the clock [nF]", ylabel="pulses [kHz]", title=title)


def _draw_dead_band(axes: Axes) -> None:
    for law, colour in LAWS.items():
        card = AmplifierConfig(law=law)  # pyright: ignore[reportArgumentType]
        codes = np.arange(-_NEAR_ZERO, _NEAR_ZERO + 1)
        volts = [motor_volts(np.full(8, code), np.zeros(8), card)[WHEEL] for code in codes]
        command = np.sign(codes) * command_volts(codes, card)
        axes.plot(1e3 * command, volts, color=colour, label=f"{law}: {dead_band(card):.3g} V dead")
    axes.set(xlabel="command [mV]", ylabel="at a wheel's motor, stalled [V]", title="dead band")


def dead_band(card: AmplifierConfig) -> float:
    """Return the least command that drives the bridge [V]."""
    volts = command_volts(np.arange(card.full_code + 1), card)
    return float(volts[np.flatnonzero(bridge_share(pulse_share(volts, card), card))[0]])


def _draw_currents(axes: Axes) -> None:
    card = AmplifierConfig()
    full = np.full(8, card.full_code)
    most = float(card.battery / min(card.motor_constant))
    speeds = np.linspace(-0.5 * most, 1.2 * most, 200)
    for motor, label, style in ((WHEEL, "wheel", "-"), (JOINT, "arm joint", "--")):
        for spent, colour in ((0.0, BLUE), (card.peak_time, RED)):
            limit = current_limit(np.full(8, spent), card)
            currents = [motor_current(full, np.full(8, v), card, limit)[motor] for v in speeds]
            text = f"{label}, after {spent:g} s above {card.continuous_current:g} A"
            axes.plot(speeds, currents, style, color=colour, label=text)
    supply = PULSE_CLOCK.supply
    axes.set(xlabel="output shaft [rad/s]", ylabel="current [A]")
    axes.set_title(f"current limit, command of {supply:g} V")
