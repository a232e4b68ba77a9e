"""``appe-bus``: BRAID's actuators are addressed by pulses on their power line (E.4).

The line and fifteen decoder chips are sampled. Clean words, one fault a word, noise, and faults at
given rates are sent by the thesis' protocol and by three that withstand a missed pulse; the flag's
buffer is held against the RC variant, which the thesis tested too and found less reliable.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from controllers.braid.bus.circuit import BusCircuit, PowerBus, with_rc_buffer
from controllers.braid.bus.code import DEFAULT_TIMING, AddressCode, duration, shortest_commands
from controllers.braid.bus.decoder_chips import Trace
from controllers.braid.bus.master import planned_commands, protocols
from controllers.braid.bus.trains import FAULT_KINDS, OneFault, trains_of
from experiments.appe.bus.bus_options import Options
from experiments.appe.bus.figures import (
    draw_durations,
    draw_faults,
    draw_lasting,
    draw_rates,
    draw_waveform,
)
from experiments.appe.bus.trial import (
    ACTUATORS,
    FATES,
    PROTOCOLS,
    BusTrial,
    BusTrialConfig,
    run_trial,
)
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep

CLEAN_WORDS = 100_000
NOISE = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)  # [V]
RATES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
LASTING_RATE = 1e-3
SPREADS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3)
MARGINS = (1.1, 1.3, 1.6)
STAGES = (5, 10, 20)
MENDED = {  # What each protocol promises to mend, when it befalls a word once.
    "parity": FAULT_KINDS,
    "repeat": FAULT_KINDS,
    "correct": ("missed", "extra"),
}
FINE_SAMPLE = 1e-6  # [s], for the oscilloscope


@dataclasses.dataclass(frozen=True)
class Sizes:
    """Numbers of words.

    Attributes:
        clean: Number of words without any fault, by protocol and buffer.
        chunk: Number of words in one job, with components of their own.
        fault: Number of words for each protocol and kind of fault.
        rate: Number of words for each protocol and rate or noise.
        lasting: Number of words in one run where errors stay.
        runs: Number of runs where errors stay.
    """

    clean: dict[tuple[str, str], int]
    chunk: int
    fault: int
    rate: int
    lasting: int
    runs: int


FULL = Sizes(
    {
        ("thesis", "flag"): CLEAN_WORDS,
        ("parity", "flag"): 20_000,
        ("repeat", "flag"): 10_000,
        ("correct", "flag"): 10_000,
        ("thesis", "rc"): 10_000,
    },
    chunk=5000,
    fault=2000,
    rate=1000,
    lasting=300,
    runs=20,
)
QUICK = Sizes(
    {key: 4000 if key == ("thesis", "flag") else 500 for key in FULL.clean},
    chunk=1000,
    fault=150,
    rate=60,
    lasting=100,
    runs=3,
)


def run(options: Options, output: Output) -> None:
    """Send words of all kinds over the bus and count what arrives.

    Args:
        options: ``quick`` sends 4,000 clean words by the thesis' protocol instead of 10^5.
        output: Receives ``word_errors/<protocol>/<buffer>``, ``fate/<fault>/<protocol>/<fate>``,
            ``change_ms/<protocol>/<stages>`` and the curves by noise and rate.
    """
    sizes = QUICK if options.quick else FULL
    plans = _plans(options, sizes)
    configs = [config for plan in plans.values() for config in plan]
    results = iter(sweep(run_trial, configs, options, output, label="trials"))
    found = {name: [next(results) for _ in plan] for name, plan in plans.items()}
    _measure_clean(found["clean"], output, options.quick)
    _measure_faults(found["faults"], output)
    _measure_curves(found, output)
    durations = _durations(options.seed, 200 if options.quick else 2000)
    _measure_durations(durations, output)
    traces = {
        "thesis: actuators 2 and 4 are toggled": _observe("thesis", False),
        "the same, one pulse missed: 1 and 4 are": _observe("thesis", True),
        "odd addresses, one pulse missed: 4 is, 2 refused": _observe("parity", True),
    }
    output.figure("figure_e-8_waveform", draw_waveform(traces, BusCircuit()))
    output.figure("bus_one_fault", draw_faults(found["faults"]))
    output.figure("bus_word_errors", draw_rates(found))
    output.figure("bus_lasting_and_rc", draw_lasting(found["lasting"], found["rc_sigma"]))
    output.figure("bus_change_time", draw_durations(durations))


def _plans(options: Options, sizes: Sizes) -> dict[str, list[BusTrialConfig]]:
    """Return the trials of each part."""
    root = np.random.SeedSequence(options.seed)
    seeds = iter(int(word) for word in root.generate_state(1000))
    count = sizes.rate
    return {
        "clean": [
            BusTrialConfig(name, min(sizes.chunk, total - first), next(seeds), buffer, lasting=True)
            for (name, buffer), total in sizes.clean.items()
            for first in range(0, total, sizes.chunk)
        ],
        "faults": [
            BusTrialConfig(name, sizes.fault, next(seeds), fault=kind)
            for kind in FAULT_KINDS
            for name in PROTOCOLS
        ],
        "noise": [
            BusTrialConfig(name, count, next(seeds), buffer, noise=level)
            for name, buffer in (*((name, "flag") for name in PROTOCOLS), ("thesis", "rc"))
            for level in NOISE
        ],
        "missed": [
            BusTrialConfig(name, count, next(seeds), missed=rate)
            for name in PROTOCOLS
            for rate in RATES
        ],
        "extra": [
            BusTrialConfig(name, count, next(seeds), extra=rate)
            for name in PROTOCOLS
            for rate in RATES
        ],
        "lasting": [
            BusTrialConfig(name, sizes.lasting, seed, missed=LASTING_RATE, lasting=True)
            for name in PROTOCOLS
            for seed in options.job_seeds(sizes.runs, sizes.runs)
        ],
        "rc_sigma": [
            BusTrialConfig("thesis", count, next(seeds), "rc", rc_sigma=share, margin=margin)
            for margin in MARGINS
            for share in SPREADS
        ],
    }


def _measure_clean(rows: Sequence[BusTrial], output: Output, quick: bool) -> None:
    """Store errors of words that nothing befell, and hold them against the bar."""
    for name, buffer in FULL.clean:
        chosen = [
            row for row in rows if row.config.protocol == name and row.config.buffer == buffer
        ]
        sent = sum(row.sent for row in chosen)
        wrong = sum(row.wrong for row in chosen)
        output.measure(f"word_errors/{name}/{buffer}", fraction(wrong, sent))
        label = f"clean words wrong, {name}, {buffer} buffer, of {sent}"
        output.check(label, wrong, "== 0", wrong == 0)
        if (name, buffer) == ("thesis", "flag") and not quick:
            output.check("clean words sent", sent, f">= {CLEAN_WORDS}", sent >= CLEAN_WORDS)


def _measure_faults(rows: Sequence[BusTrial], output: Output) -> None:
    """Store what one fault does to a word, and whether the promises are kept."""
    table = []
    for row in rows:
        name, kind = row.config.protocol, row.config.fault
        fates = [row.fates[fate] for fate in FATES]
        table.append([kind, name, row.sent, *fates, row.resent, row.rewritten])
        for fate in FATES:
            output.measure(f"fate/{kind}/{name}/{fate}", fraction(row.fates[fate], row.sent))
        output.measure(f"resent_per_word/{kind}/{name}", row.resent / row.sent)
        if kind in MENDED.get(name, ()):
            label = f"words wrong unknown to the master, {name}, one {kind} each, of {row.sent}"
            output.check(label, row.silent, "== 0", row.silent == 0)
        elif name == "correct":
            label = f"wrong actuators moved, {name}, one {kind} each, of {row.sent} words"
            output.check(label, row.fates["wrong"], "== 0", row.fates["wrong"] == 0)
        elif kind == "missed":
            label = f"the thesis' protocol goes wrong by one missed pulse, of {row.sent}"
            output.check(label, row.silent, f"== {row.sent}", row.silent == row.sent)
    columns = ["fault", "protocol", "words", *FATES, "trains resent", "words rewritten"]
    output.table("bus_one_fault", columns, table)


def _measure_curves(found: dict[str, list[BusTrial]], output: Output) -> None:
    """Store the shares of words that are not right by noise, rate of faults and RC tolerance."""
    for part in ("noise", "missed", "extra"):
        for row in found[part]:
            where = f"{row.config.protocol}/{row.config.buffer}/{getattr(row.config, part):g}"
            output.measure(f"word_errors_by_{part}/{where}", fraction(row.wrong, row.sent))
            output.measure(f"silent_errors_by_{part}/{where}", fraction(row.silent, row.sent))
    for row in found["rc_sigma"]:
        where = f"{row.config.margin:g}/{row.config.rc_sigma:g}"
        output.measure(f"word_errors_by_rc/{where}", fraction(row.wrong, row.sent))
    for name in PROTOCOLS:
        last = [row.wrong_bits[-1] for row in found["lasting"] if row.config.protocol == name]
        output.measure(f"lasting_wrong_bits/{name}", distribution(last))


def _durations(seed: int, words: int) -> dict[str, dict[int, np.ndarray]]:
    """Return the times of changes between random words [s], by protocol and actuators."""
    rng = np.random.default_rng(seed)
    durations: dict[str, dict[int, np.ndarray]] = {}
    for stages in STAGES:
        count = 3 * stages
        pairs = rng.random((words, 2, count)) < 0.5
        for name, protocol in protocols(count).items():
            bus = PowerBus(protocol.code, rng)
            changes = (planned_commands(protocol, bus, *pair) for pair in pairs)
            times = np.array([duration(protocol.code, commands) for commands in changes])
            durations.setdefault(name, {})[count] = times
        code = AddressCode(count)
        _, timing = with_rc_buffer(BusCircuit(), code, DEFAULT_TIMING, 1.3)
        changes = (shortest_commands(code, start, goal, timing) for start, goal in pairs)
        times = np.array([duration(code, commands, timing) for commands in changes])
        durations.setdefault("thesis, RC buffer", {})[count] = times
    return durations


def _measure_durations(durations: dict[str, dict[int, np.ndarray]], output: Output) -> None:
    for name, by_count in durations.items():
        label = "thesis_rc" if "RC" in name else name
        for count, times in by_count.items():
            output.measure(f"change_ms/{label}/{count // 3}", distribution(1e3 * times))


def _observe(protocol: str, faulty: bool) -> Trace:
    """Return what the first chip sees of two trains, the first with a missed pulse or not."""
    circuit = BusCircuit(sample=FINE_SAMPLE, noise=0.03)
    bus = PowerBus(protocols(ACTUATORS)[protocol].code, np.random.default_rng(0), circuit)
    trains = trains_of(bus.code, (3, 5))
    return bus.observe(list(map(OneFault("missed", 1), trains)) if faulty else trains)
