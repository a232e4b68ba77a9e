"""``appd-radio``: the thesis' handshake beside a framed link, on emulated 9600-baud modems.

Bytes are changed, lost and inserted at a given rate, alike and in both directions. Virtual time
carries an hour of radio in seconds. The handshake answers each byte, so it is the slower the more
the modems delay; the framed link hardly is. In the end two rovers drive and report their
positions to each other.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.appd.radio.demo import ROBOTS, SEND_PERIOD, converse
from experiments.appd.radio.figures import (
    draw_conversation,
    draw_fates,
    draw_goodput,
    draw_latency,
    draw_progress,
)
from experiments.appd.radio.radio_options import Options
from experiments.appd.radio.trial import (
    FATES,
    LINKS,
    PooledTrials,
    RadioTrial,
    TrialConfig,
    run_trial,
)
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.recording import RunFiles
from experiments.harness.sweep import sweep
from twin.hardware.emulator.modem import ModemConfig

RATES = (0.0, 1e-3, 1e-2, 3e-2)
RATE = 1e-2  # that of the bars
DELAYS = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02)  # [s]
HOST_PERIOD = 0.01  # [s] of a host that polls in its servo loop
GOODPUT_BOUND = 5.0
LEAST_MESSAGES = 10_000
COUNTS = (1000, 400)  # messages a trial: full, quick
TALK = (30.0, 10.0)  # [s] that the rovers drive: full, quick
PERCENTILES = (50, 95, 99)


def run(options: Options, output: Output) -> None:
    """Send messages over both links at each error rate, and let two rovers talk.

    Args:
        options: ``quick`` sends 1,200 messages a link and rate instead of 10,000.
        output: Receives ``silent_errors/<link>`` and ``goodput/<link>``, and both by error rate.
    """
    plans = _plans(options)
    configs = [config for plan in plans.values() for config in plan]
    results = iter(sweep(run_trial, configs, options, output, label="trials"))
    found = {name: [next(results) for _ in plan] for name, plan in plans.items()}
    rates = [_pool(link, rate, found["rates"]) for link in LINKS for rate in RATES]
    delays = [_pool(trial.link, RATE, [trial]) for trial in found["delays"]]
    _measure_rates(rates, output)
    _measure_bars(rates, output, options.quick)
    _measure_others(found, delays, output)
    _tabulate(rates, found["paced"], output)
    output.figure("radio_fates", draw_fates(rates))
    output.figure("radio_goodput", draw_goodput(rates, delays))
    firsts = [_chosen(found["rates"], link, RATE)[0] for link in LINKS]
    output.figure("radio_stalls", draw_progress(firsts))
    paced = {link: [t for t in found["paced"] if t.link == link] for link in LINKS}
    output.figure("radio_latency", draw_latency(paced))
    _talk(options, output)


def _plans(options: Options) -> dict[str, list[TrialConfig]]:
    """Return all trials: by error rate, one message a second, by delay, and with polling hosts."""
    seeds = options.job_seeds(10, 3)
    count = COUNTS[options.quick]
    one = seeds[0]
    return {
        "rates": [
            TrialConfig(link, rate, options.delay, count, seed)
            for link in LINKS
            for rate in RATES
            for seed in seeds
        ],
        "paced": [
            TrialConfig(link, rate, options.delay, count, one, period=1.0)
            for link in LINKS
            for rate in RATES
        ],
        "delays": [
            TrialConfig(link, RATE, delay, count, one) for link in LINKS for delay in DELAYS
        ],
        "polled": [
            TrialConfig(link, RATE, options.delay, count, one, poll=HOST_PERIOD) for link in LINKS
        ],
    }


def _chosen(trials: Sequence[RadioTrial], link: str, rate: float) -> list[RadioTrial]:
    return [trial for trial in trials if trial.link == link and trial.error_rate == rate]


def _pool(link: str, rate: float, trials: Sequence[RadioTrial]) -> PooledTrials:
    """Return the trials of one link and error rate as one."""
    chosen = _chosen(trials, link, rate)
    counted = (*FATES, "sent", "duplicates", "disordered", "wrong_received", "stalls")
    return PooledTrials(
        link=link,
        error_rate=rate,
        delay=chosen[0].delay,
        **{key: sum(getattr(trial, key) for trial in chosen) for key in counted},
        duration=sum(trial.duration for trial in chosen),
        goodput=distribution([trial.goodput for trial in chosen]),
    )


def _measure_rates(rows: Sequence[PooledTrials], output: Output) -> None:
    """Store each link's results by error rate."""
    for row in rows:
        where, count = f"{row.link}/{row.error_rate:g}", row.sent
        output.measure(f"silent_errors/{where}", fraction(row.wrong, count))
        output.measure(f"vanished/{where}", fraction(row.vanished, count))
        output.measure(f"delivered_fraction/{where}", fraction(row.intact, count))
        output.measure(f"stalled_fraction/{where}", fraction(row.stalls, count))
        output.measure(f"goodput/{where}", row.goodput)


def _measure_bars(rows: Sequence[PooledTrials], output: Output, quick: bool) -> None:
    """Store the headline and hold it against the bars."""
    at = {row.link: row for row in rows if row.error_rate == RATE}
    for link, row in at.items():
        output.measure(f"silent_errors/{link}", fraction(row.wrong, row.sent))
        output.measure(f"goodput/{link}", row.goodput)
    framed, handshake = at["framed"], at["handshake"]
    sent = framed.sent
    for label, key in (
        ("silently wrong", "wrong_received"),
        ("vanished though confirmed", "vanished"),
        ("delivered twice", "duplicates"),
        ("out of order", "disordered"),
    ):
        name = f"framed messages {label}, of {sent} at a byte error rate of {RATE:g}"
        output.check(name, getattr(framed, key), "== 0", getattr(framed, key) == 0)
    if not quick:
        enough = sent >= LEAST_MESSAGES
        output.check("framed messages at that rate", sent, f">= {LEAST_MESSAGES}", enough)
    ratio = framed.goodput["median"] / handshake.goodput["median"]
    output.measure("goodput_ratio/framed_over_handshake", ratio)
    output.check(
        f"goodput, framed over handshake, modem delay {1e3 * framed.delay:g} ms",
        ratio,
        f">= {GOODPUT_BOUND:g}",
        ratio >= GOODPUT_BOUND,
    )
    failures = handshake.wrong + handshake.vanished
    output.check("the handshake's own silent failures are seen", failures, "> 0", failures > 0)


def _measure_others(
    found: Mapping[str, Sequence[RadioTrial]], delays: Sequence[PooledTrials], output: Output
) -> None:
    """Store latency, and the goodput with other delays and with hosts that poll."""
    for trial in found["paced"]:
        times = 1e3 * np.asarray(trial.latency)
        where = f"{trial.link}/{trial.error_rate:g}"
        output.measure(f"latency_ms/{where}", distribution(times) if times.size else "none")
    goodput = {(row.link, row.delay): row.goodput["median"] for row in delays}
    for delay in DELAYS:
        ratio = goodput["framed", delay] / goodput["handshake", delay]
        output.measure(f"goodput_ratio/delay_{1e3 * delay:g}_ms", ratio)
    for trial in found["polled"]:
        output.measure(f"goodput_polled_100_hz/{trial.link}", trial.goodput)


def _tabulate(rows: Sequence[PooledTrials], paced: Sequence[RadioTrial], output: Output) -> None:
    """Write the fates and the latencies."""
    counted = ("sent", *FATES, "wrong_received", "duplicates", "disordered", "stalls")
    columns = ("link", "byte error rate", *counted, "duration [s]", "goodput [B/s]")
    table = [
        [row.link, row.error_rate, *(getattr(row, key) for key in counted)]
        + [row.duration, row.goodput["median"]]
        for row in rows
    ]
    output.table("radio_fates", columns, table)
    heads = [f"latency {percent} % [ms]" for percent in PERCENTILES]
    output.table(
        "radio_latency",
        ("link", "byte error rate", "intact", "sent", *heads),
        [
            [trial.link, trial.error_rate, trial.intact, trial.sent]
            + [_percentile(trial.latency, percent) for percent in PERCENTILES]
            for trial in paced
        ],
    )


def _percentile(latency: np.ndarray, percent: float) -> float:
    """Return a percentile of the intact messages' latency [ms]; NaN if there is none."""
    return float(1e3 * np.percentile(latency, percent)) if latency.size else math.nan


def _talk(options: Options, output: Output) -> None:
    """Let two rovers drive and talk, and store what each knew of the other."""
    duration = TALK[options.quick]
    modems = ModemConfig(delay=options.delay, error_rate=RATE)
    result = converse(modems, duration, options.seed, RunFiles.of(options, output))
    period = float(np.median(np.diff(result.truth[:, 0])))
    rows: list[list[Any]] = []
    for name, other in zip(ROBOTS, reversed(ROBOTS)):
        sent, heard = result.rovers[name], result.rovers[other]
        # The last ones may still be on their way.
        last = sent.sent[-1, 0]
        poses = int(np.sum(heard.received[:, 1] < last - 1e-3))
        total = int(np.sum(sent.sent[:, 0] < last))
        output.measure(f"talk/poses_received_fraction/{name}", fraction(poses, total))
        ages = 1e3 * heard.age[np.isfinite(heard.age)]
        output.measure(f"talk/pose_age_ms/{name}", distribution(ages))
        share = 100.0 * float(sent.bytes_sent[-1]) / (960.0 * duration)
        output.measure(f"talk/line_used_percent/{name}", share)
        rows.append([name, total, poses, float(np.median(ages)), float(ages.max()), share])
    output.measure("talk/pose_payload_percent", 100.0 * 20.0 / SEND_PERIOD / 960.0)
    columns = ("sender", "poses sent", "poses received", "pose age median [ms]")
    output.table("radio_talk", (*columns, "pose age most [ms]", "line used [%]"), rows)
    output.figure("radio_talk", draw_conversation(result, period))
