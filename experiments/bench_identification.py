"""Our estimator beside MuJoCo's own ``mujoco.sysid``, on the same recorded noisy data."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from controllers.identification.arm_motion import MODES, RigidArm, Trajectory
from controllers.identification.compliant_base import ArmOnMount
from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.identifier import Identifier, IdentifierConfig
from controllers.identification.output_error import OutputError, Window
from controllers.identification.parameters import (
    Prior,
    average_error_percent,
    from_mapping,
)
from experiments.ch2_plant import NOISE_FRACTION, Plant
from experiments.ch2_trial import fixed_scale
from experiments.contract import Options
from experiments.intervals import distribution
from experiments.output import Output
from experiments.sysid_peer import SysidPeer
from models.datasheets import TABLE_2_1_TRUTH

FloatArray = NDArray[np.float64]

DURATION = 4.0
"""Of the recording, for both sides [s]; 10 s would take the peer minutes and change no ratio."""
QUICK_DURATION = 1.2
ITERATIONS = 12
"""Most iterations of the peer, each of at least 23 simulations."""
TIME_BOUND, ERROR_BOUND = 1 / 50, 1.0


@dataclasses.dataclass(frozen=True)
class Recording:
    """What one run of the plant left.

    Attributes:
        windows: Arm motions by mode, window after window.
        outputs: (n, 24) noisy outputs by mode of each window.
        sigma: (24,) deviations of the noise.
    """

    windows: list[dict[str, Trajectory]]
    outputs: list[dict[str, FloatArray]]
    sigma: FloatArray

    def motions(self) -> dict[str, Trajectory]:
        """Return each mode's whole motion."""
        joined = dict(self.windows[0])
        for window in self.windows[1:]:
            joined = {mode: joined[mode].then(path) for mode, path in window.items()}
        return joined

    def joined(self) -> dict[str, FloatArray]:
        """Return each mode's whole outputs."""
        return {mode: np.concatenate([part[mode] for part in self.outputs]) for mode in MODES}


def record(duration: float, seed: int) -> Recording:
    """Run the plant of Table 2-1 under the information excitation, with fixed 10 % noise."""
    truth = tuple(from_mapping(TABLE_2_1_TRUTH).tolist())
    noise, planning = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2)
    )
    identifier = Identifier(IdentifierConfig("information"), planning)
    plants = {mode: Plant(TABLE_2_1_TRUTH, mode) for mode in MODES}
    bound = NOISE_FRACTION * fixed_scale(truth)
    recording = Recording([], [], bound / np.sqrt(3))
    for _ in range(round(duration / REPLAN_PERIOD)):
        motions = identifier.next_motion()
        clean = {mode: plants[mode].follow(path) for mode, path in motions.items()}
        noisy = {mode: y + noise.uniform(-bound, bound, y.shape) for mode, y in clean.items()}
        identifier.measured(noisy, recording.sigma)
        recording.windows.append(motions)
        recording.outputs.append(noisy)
    return recording


def fit_ours(recording: Recording, arms: Mapping[str, ArmOnMount]) -> FloatArray:
    """Return our estimate (22,): window after window from the prior, as on a robot, then fitted."""
    search = OutputError(arms)
    for motions, outputs in zip(recording.windows, recording.outputs, strict=True):
        search.add({mode: Window(motions[mode], outputs[mode], recording.sigma) for mode in arms})
    return search.fit().parameters


def bench_identification(options: Options, output: Output) -> None:
    """Fit the same data by our estimator and by the peer, each at its best.

    Args:
        options: ``quick`` records 1.2 s instead of 4 s, for both, ``seeds`` repetitions (4).
        output: Receives ``sysid_time_ratio``, ``sysid_error_ratio`` and what they are made of.
    """
    arms = {mode: ArmOnMount.of(RigidArm(), mode) for mode in MODES}
    truth = from_mapping(TABLE_2_1_TRUTH)
    duration = QUICK_DURATION if options.quick else DURATION
    names = ("ours_cpu_s", "sysid_cpu_s", "ours_error_percent", "sysid_error_percent")
    rows: dict[str, list[float]] = {name: [] for name in names}
    for index, seed in enumerate(options.job_seeds(4, 1)):
        recording = record(duration, seed)
        if index == 0:
            fit_ours(record(REPLAN_PERIOD, seed), arms)  # compiles
        start = time.process_time()
        ours = fit_ours(recording, arms)
        ours_seconds = time.process_time() - start
        peer, peer_seconds = SysidPeer(
            recording.motions(), recording.joined(), recording.sigma, arms, Prior()
        ).fit(ITERATIONS)
        errors = [average_error_percent(found, truth) for found in (ours, peer)]
        for name, value in zip(names, [ours_seconds, peer_seconds, *errors], strict=True):
            rows[name].append(value)
    for name, values in rows.items():
        output.measure(f"sysid/{name}", distribution(values))
    output.measure("sysid/duration_s", duration)
    # Equal but for chance: both seek the same optimum, which says more than the medians' ratio.
    difference = np.subtract(rows["ours_error_percent"], rows["sysid_error_percent"])
    output.measure("sysid/error_difference_percent", distribution(difference))
    ratios = {
        "time": np.divide(rows["ours_cpu_s"], rows["sysid_cpu_s"]),
        "error": np.divide(rows["ours_error_percent"], rows["sysid_error_percent"]),
    }
    for name, bound in (("time", TIME_BOUND), ("error", ERROR_BOUND)):
        found = distribution(ratios[name])
        output.measure(f"sysid_{name}_ratio", found)
        median = found["median"]
        text = f"identification, {name} over that of mujoco.sysid"
        output.check(text, median, f"<= {bound:g}", median <= bound)
