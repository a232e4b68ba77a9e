"""Our estimator beside MuJoCo's own ``mujoco.sysid``, on the same recorded noisy data.

Who integrates as the data were integrated has an advantage that no real robot gives: the longest
steps of RK4 that the compliance bears move the estimates by up to a twentieth of their deviations.
So the plant is integrated more finely here than on either side; what sharing the step gives the
peer is measured beside it.
"""

import dataclasses
import time
from collections.abc import Mapping

import numpy as np

from controllers.identification.arm_motion import MODES, RigidArm, Trajectory
from controllers.identification.compliant_base import ArmOnMount, BaseState, simulate
from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.identifier import Identifier, IdentifierConfig
from controllers.identification.output_error import OutputError, Window
from controllers.identification.parameters import (
    COUNT,
    INERTIA,
    Prior,
    average_error_percent,
    coordinate_scale,
    from_coordinates,
    from_mapping,
    largest_physical_step,
    to_coordinates,
)
from experiments.bench import sysid_peer
from experiments.bench.sysid_peer import SysidPeer
from experiments.ch2.simulation.plant import NOISE_FRACTION, SAMPLING, Plant
from experiments.ch2.simulation.trial import fixed_scale
from experiments.harness.contract import ExperimentError, Options
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from models.datasheets import TABLE_2_1_TRUTH
from perception.geometry.arrays import FloatArray

DURATION = 4.0
"""Of the recording, for both sides [s]; 10 s would take the peer minutes and change no ratio."""
QUICK_DURATION = 1.2
ITERATIONS = 12
"""Most iterations of the peer, each of at least 23 simulations."""
PLANT_SUBSTEPS = 50
"""Physics steps a sample of the plant: RK4's error is then 1/625 of that at 0.5 ms."""
FINE_SUBSTEPS = 20
"""Those of the peer where only its error counts."""
DERIVATIVE_SUBSTEPS = 8
"""Integration steps a sample of our model's derivatives, by which the peer's least cost is sought:
they are then those of the peer's model but for its own error of integration."""
SETTLING, SETTLED = 20, 1e-5
"""Most steps towards the peer's least cost, and the gain of half the squared residuals at which it
is reached: 0.005 deviations away."""
TIME_BOUND, ERROR_BOUND = 1 / 50, 1.0
LARGEST_EXCESS = 1.01
"""Ratio of the errors that the whole interval must stay below, or "no higher" says too little."""


@dataclasses.dataclass(frozen=True)
class Recording:
    """What one run of the plant left.

    Attributes:
        windows: Arm motions by mode, window after window.
        clean: (n, 24) noise-free outputs by mode of each window.
        noise: (n, 24) what the sensors add to them.
        sigma: (24,) deviations of the noise.
    """

    windows: list[dict[str, Trajectory]]
    clean: list[dict[str, FloatArray]]
    noise: list[dict[str, FloatArray]]
    sigma: FloatArray

    @property
    def outputs(self) -> list[dict[str, FloatArray]]:
        """Noisy outputs (n, 24) by mode of each window."""
        pairs = zip(self.clean, self.noise, strict=True)
        return [{mode: clean[mode] + noise[mode] for mode in clean} for clean, noise in pairs]

    def motions(self) -> dict[str, Trajectory]:
        """Return each mode's whole motion."""
        joined = dict(self.windows[0])
        for window in self.windows[1:]:
            joined = {mode: joined[mode].then(path) for mode, path in window.items()}
        return joined

    def joined(self) -> dict[str, FloatArray]:
        """Return each mode's whole noisy outputs."""
        outputs = self.outputs
        return {mode: np.concatenate([part[mode] for part in outputs]) for mode in MODES}

    def integrated(self, substeps: int) -> "Recording":
        """Return the same motions and noise, the plant taking so many steps a sample."""
        plants = _plants(substeps)
        clean = [
            {mode: plants[mode].follow(path) for mode, path in window.items()}
            for window in self.windows
        ]
        return dataclasses.replace(self, clean=clean)

    def without_noise(self) -> "Recording":
        """Return the same, with what the sensors add left out."""
        still = [{mode: np.zeros_like(y) for mode, y in part.items()} for part in self.clean]
        return dataclasses.replace(self, noise=still)


def record(duration: float, seed: int) -> Recording:
    """Run the plant of Table 2-1 under the information excitation, with fixed 10 % noise."""
    truth = tuple(from_mapping(TABLE_2_1_TRUTH).tolist())
    generator, planning = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2)
    )
    identifier = Identifier(IdentifierConfig("information"), planning)
    plants = _plants(PLANT_SUBSTEPS)
    bound = NOISE_FRACTION * fixed_scale(truth)
    recording = Recording([], [], [], bound / np.sqrt(3))
    for _ in range(round(duration / REPLAN_PERIOD)):
        motions = identifier.next_motion()
        clean = {mode: plants[mode].follow(path) for mode, path in motions.items()}
        noise = {mode: generator.uniform(-bound, bound, y.shape) for mode, y in clean.items()}
        identifier.measured({mode: clean[mode] + noise[mode] for mode in clean}, recording.sigma)
        recording.windows.append(motions)
        recording.clean.append(clean)
        recording.noise.append(noise)
    return recording


def _plants(substeps: int) -> dict[str, Plant]:
    step = SAMPLING / substeps
    return {mode: Plant(TABLE_2_1_TRUTH, mode, time_step=step) for mode in MODES}


def fit_ours(recording: Recording, arms: Mapping[str, ArmOnMount], restarts: int = 3) -> FloatArray:
    """Return our estimate (22,): window after window from the prior, as on a robot, then fitted."""
    search = OutputError(arms)
    for motions, outputs in zip(recording.windows, recording.outputs, strict=True):
        search.add({mode: Window(motions[mode], outputs[mode], recording.sigma) for mode in arms})
    return search.fit(restarts=restarts).parameters


def peer_optimum(
    recording: Recording, arms: Mapping[str, ArmOnMount], substeps: int, near: FloatArray
) -> FloatArray:
    """Return where the peer's cost is least (22,): what it finds with all the time it wants.

    Args:
        recording: The data.
        arms: The arm in each mode.
        substeps: The peer's physics steps a sample.
        near: (22,) physical parameters to start from.

    Raises:
        ExperimentError: If Gauss-Newton steps from there do not settle.
    """
    motions, sigma = recording.motions(), recording.sigma
    peer = SysidPeer(motions, recording.joined(), sigma, arms, Prior(), substeps)

    theta, gain = to_coordinates(near), np.inf
    for _ in range(SETTLING):
        parameters = from_coordinates(theta)
        # Where the gradient of noisy data vanishes, the derivatives' own error counts as well.
        by_mode = [
            simulate(parameters, arms[mode], path, BaseState.at_rest(), True, DERIVATIVE_SUBSTEPS)
            for mode, path in motions.items()
        ]
        rows = np.concatenate([(part[1] / sigma[:, None]).reshape(-1, COUNT) for part in by_mode])
        rows *= coordinate_scale(theta)
        gradient = rows.T @ peer.residual(parameters)
        step: FloatArray = -np.linalg.solve(rows.T @ rows, gradient).astype(np.float64)
        gain = -0.5 * float(gradient @ step)
        step[INERTIA] *= largest_physical_step(theta, step)
        theta = theta + step
        if gain < SETTLED:
            return from_coordinates(theta)
    raise ExperimentError(f"the peer's cost still falls by {gain:.1g} after {SETTLING} steps")


def bench_identification(options: Options, output: Output) -> None:
    """Fit the same data by our estimator and by the peer, each at its best.

    Args:
        options: ``quick`` records 1.2 s instead of 4 s, for both; ``seeds`` repetitions (4 of the
            peer's own search, which takes minutes, and 16 of the errors at the least cost).
        output: Receives ``sysid_time_ratio``, ``sysid_error_ratio`` and what they are made of.
    """
    arms = {mode: ArmOnMount.of(RigidArm(), mode) for mode in MODES}
    duration = QUICK_DURATION if options.quick else DURATION
    output.measure("sysid/duration_s", duration)
    seeds = options.job_seeds(4, 1)
    fit_ours(record(REPLAN_PERIOD, seeds[0]), arms)  # compiles
    _compare_searches([record(duration, seed) for seed in seeds], arms, output)
    _compare_errors([record(duration, seed) for seed in options.job_seeds(16, 2)], arms, output)


def _compare_searches(
    recordings: list[Recording], arms: Mapping[str, ArmOnMount], output: Output
) -> None:
    """Measure what both searches take, and what they find."""
    truth = from_mapping(TABLE_2_1_TRUTH)
    names = ("ours_cpu_s", "sysid_cpu_s", "searched_excess_percent")
    rows: dict[str, list[float]] = {name: [] for name in names}
    for recording in recordings:
        start = time.process_time()
        ours = fit_ours(recording, arms)
        ours_seconds = time.process_time() - start
        peer, peer_seconds = SysidPeer(
            recording.motions(), recording.joined(), recording.sigma, arms, Prior()
        ).fit(ITERATIONS)
        excess = average_error_percent(ours, truth) - average_error_percent(peer, truth)
        for name, value in zip(names, (ours_seconds, peer_seconds, excess), strict=True):
            rows[name].append(value)
    for name, values in rows.items():
        output.measure(f"sysid/{name}", distribution(values))
    ratio = distribution(np.divide(rows["ours_cpu_s"], rows["sysid_cpu_s"]))
    output.measure("sysid_time_ratio", ratio)
    text = "identification, time over that of mujoco.sysid"
    output.check(text, ratio["median"], f"<= {TIME_BOUND:g}", ratio["median"] <= TIME_BOUND)


def _compare_errors(
    recordings: list[Recording], arms: Mapping[str, ArmOnMount], output: Output
) -> None:
    """Measure both errors where each side's cost is least.

    On data of a plant that neither integrates alike, and on data of the peer's own steps.
    """
    truth = from_mapping(TABLE_2_1_TRUTH)
    kinds = {"": FINE_SUBSTEPS, "shared_step/": sysid_peer.SUBSTEPS}
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in kinds}
    for recording in recordings:
        for kind, substeps in kinds.items():
            data = recording.integrated(substeps) if kind else recording
            ours = fit_ours(data, arms)
            peer = peer_optimum(data, arms, substeps, ours)
            errors = average_error_percent(ours, truth), average_error_percent(peer, truth)
            found[kind].append(errors)
    for kind, errors in found.items():
        ours, peer = np.array(errors).T
        output.measure(f"sysid/{kind}ours_error_percent", distribution(ours))
        output.measure(f"sysid/{kind}sysid_error_percent", distribution(peer))
        output.measure(f"sysid/{kind}excess_percent", distribution(ours - peer))
        output.measure(f"sysid_error_ratio{kind and '/shared_step'}", distribution(ours / peer))
    for kind, errors in found.items():
        ratio = distribution(np.divide(*np.array(errors).T))
        # Both seek the same optimum, so chance decides on which side of 1 the median lies.
        text = f"identification, error over that of mujoco.sysid{kind and ', its own steps'}"
        bound = f"<= {ERROR_BOUND:g} within its interval"
        output.check(text, ratio["median"], bound, ratio["low"] <= ERROR_BOUND)
        if not kind:
            high, bound = ratio["high"], f"<= {LARGEST_EXCESS:g}"
            output.check(f"{text}, upper end", high, bound, high <= LARGEST_EXCESS)
