"""Our estimator beside MuJoCo's own ``mujoco.sysid``, on the same recorded noisy data.

A side that integrates as the data were integrated has an advantage that no real robot gives: the
longest stable steps of RK4 move the estimates by up to a twentieth of their deviations. So the
plant is integrated more finely here than on either side; the advantage of a shared step is measured
beside it.
"""

import dataclasses
import io
import time
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from mujoco.sysid import ModelSequences  # mujoco.sysid is there, but empty, without its extra.
from scipy.spatial.transform import Rotation

from controllers.identification.arm_motion import MODES, RigidArm, Trajectory, mode_axes
from controllers.identification.compliant_base import (
    CHANNELS,
    SIGNALS,
    ArmOnMount,
    BaseState,
    simulate,
)
from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.identifier import Identifier, IdentifierConfig
from controllers.identification.output_error import OutputError, Window
from controllers.identification.parameters import (
    COUNT,
    INERTIA_ELEMENTS,
    LEVER,
    NAMES,
    STIFFNESS,
    Prior,
    average_error_percent,
    coordinate_scale,
    from_coordinates,
    from_mapping,
    physical_step,
    second_moments,
    to_coordinates,
)
from experiments.bench.bench_options import Options
from experiments.ch2.simulation.plant import NOISE_FRACTION, SAMPLING, Plant
from experiments.ch2.simulation.trial import fixed_scale
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from models.compliant_base.build import hold_arm, set_parameters
from models.datasheets import TABLE_2_1_TRUTH
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

DURATION = 4.0
"""Length of the recording, for both sides [s]; 10 s would take the peer minutes and change no
ratio."""
QUICK_DURATION = 0.8
ITERATIONS = 12
"""Most iterations of the peer, each of at least 23 simulations."""
PLANT_SUBSTEPS = 50
"""Physics steps a sample of the plant: RK4's error is 1/625 of that at 0.5 ms."""
PEER_SUBSTEPS = 10
"""Physics steps a sample of the peer: 0.5 ms, the longest that the stiff compliance bears."""
FINE_SUBSTEPS = 20
"""Physics steps a sample of the peer where only its error counts."""
SMALLEST_GAIN = 1e-3
"""Gain of half the squared residuals at which our estimator stops."""
DERIVATIVE_SUBSTEPS = 8
"""Integration steps a sample of our model's derivatives, which find the peer's least cost: they
equal those of the peer's model but for its own error of integration."""
SETTLING, SETTLED = 20, 1e-5
"""Most steps towards the peer's least cost, and the gain of half the squared residuals at which it
is reached: 0.005 deviations away."""
TIME_BOUND, ERROR_BOUND = 1 / 50, 1.0
LARGEST_EXCESS = 1.01
"""Bound of the ratio's whole interval: a wide interval about 1 would show nothing."""
_LOWER = np.tril_indices(3)
_DIAGONAL = np.equal(*_LOWER)


@dataclasses.dataclass(frozen=True)
class Recording:
    """Recording of one run of the plant.

    Attributes:
        windows: Arm motions by mode, window after window.
        clean: (n, 24) noise-free outputs by mode of each window.
        noise: (n, 24) noise of the sensors by mode of each window.
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


class SysidPeer:
    """Fits the 22 parameters by ``mujoco.sysid`` to the recordings of all modes.

    It gets what our estimator gets: the arm's continuous motion (jerk as the control, not a held
    angle), residuals over the noise's deviation, coordinates in which every point is a body, and
    the prior's guess to start from. Its derivatives are finite differences, its integrator RK4.
    """

    def __init__(
        self,
        motions: Mapping[str, Trajectory],
        outputs: Mapping[str, FloatArray],
        sigma: FloatArray,
        arms: Mapping[str, ArmOnMount],
        prior: Prior,
        substeps: int = PEER_SUBSTEPS,
    ) -> None:
        """Prepare models and data.

        Args:
            motions: Arm motion over n steps, by mode.
            outputs: (n, 24) measured deviations from rest, by mode.
            sigma: (24,) deviations of the noise.
            arms: Model of the arm in each mode.
            prior: Initial guess; it does not enter the cost.
            substeps: Number of physics steps a sample.
        """
        self._sigma = sigma
        self._substeps = substeps
        self._arms = arms
        self._guess = from_coordinates(prior.mean())
        self._factor = float(np.sqrt(second_moments(self._guess)[0, 0]))
        self._measured: dict[str, FloatArray] = {}
        sequences = [self._sequence(mode, motions[mode], outputs[mode]) for mode in motions]
        self._residual = sysid.build_residual_fn(
            models_sequences=sequences,
            build_model=self._build,
            modify_residual=self._compare,
            resample_true=False,
            n_threads=1,
        )

    def fit(self, iterations: int) -> tuple[FloatArray, float]:
        """Fit, with at most so many iterations; it may stop before by its own tolerances.

        Returns:
            The 22 physical parameters, and the CPU time until a step gained as little as that at
            which our own estimator stops [s]; later steps are not counted.
        """
        params = sysid.ParameterDict()
        span = np.full(len(NAMES), 6.0)
        params.add(sysid.Parameter("theta", np.zeros(len(NAMES)), -span, span))
        start = time.process_time()
        times: list[float] = []
        costs: list[float] = []

        def watch(log: list[Any]) -> None:
            times.append(time.process_time() - start)
            costs.append(float(log[-1].objective))

        found, _ = sysid.optimize(
            params,
            self._residual,
            optimizer="mujoco",
            verbose=False,
            max_iters=iterations,
            output=io.StringIO(),
            iter_callback=watch,
        )
        gains = -np.diff(costs)
        stop = int(np.argmax(gains < SMALLEST_GAIN)) if gains.min() < SMALLEST_GAIN else -1
        return self._physical(found["theta"].value), times[stop]

    def residual(self, parameters: FloatArray) -> FloatArray:
        """Return all weighted residuals at the physical `parameters`."""
        theta = np.zeros(len(NAMES))
        used = np.array([0, *range(10, 22)])
        theta[used] = np.log(parameters[used] / self._guess[used])
        theta[LEVER] = parameters[LEVER]
        factor = (np.linalg.cholesky(second_moments(parameters)) / self._factor)[_LOWER]
        factor[_DIAGONAL] = np.log(factor[_DIAGONAL])
        theta[1:7] = factor
        params = sysid.ParameterDict()
        params.add(sysid.Parameter("theta", theta, theta - 1, theta + 1))
        return np.concatenate([part.ravel() for part in self._residual(theta, params)[0]])

    def _physical(self, theta: FloatArray) -> FloatArray:
        """Logarithms about the guess; the inertia by its log-Cholesky factor."""
        parameters = self._guess * np.exp(theta)
        parameters[LEVER] = theta[LEVER]
        entries = theta[1:7].copy()
        entries[_DIAGONAL] = np.exp(entries[_DIAGONAL])
        factor = np.zeros((3, 3))
        factor[_LOWER] = self._factor * entries
        moments = factor @ factor.T
        tensor = np.trace(moments) * np.eye(3) - moments
        parameters[1:7] = [tensor[element] for element in INERTIA_ELEMENTS]
        return parameters

    def _sequence(self, mode: str, motion: Trajectory, outputs: FloatArray) -> ModelSequences:
        axis, rotation = mode_axes(mode)
        spec = hold_arm(axis, rotation)
        spec.modelname = mode
        spec.option.timestep = motion.time_step / self._substeps
        for name, kind in (
            ("linear", mujoco.mjtSensor.mjSENS_FRAMELINACC),
            ("angular", mujoco.mjtSensor.mjSENS_FRAMEANGACC),
        ):
            sensor = spec.add_sensor(name=name, type=kind, objname="base")
            sensor.objtype = mujoco.mjtObj.mjOBJ_BODY
        model = spec.compile()
        step = spec.option.timestep
        # A sensor's row is one step behind, and the toolbox drops the last step: two more.
        jerk = np.append(np.repeat(motion.jerk, self._substeps), [0.0, 0.0])
        start = np.zeros(model.nq)
        start[6] = self._arms[mode].rest_angle
        rest = sysid.create_initial_state(model, start, np.zeros(model.nv), np.zeros(model.na))
        control = sysid.TimeSeries(step * np.arange(jerk.size), jerk[:, None])
        # The measured channels are not MuJoCo's sensors: `_compare` takes them from `_measured`.
        self._measured[mode] = outputs
        unused = sysid.TimeSeries(control.times[:1], np.zeros((1, model.nsensordata)))
        return ModelSequences(mode, spec, "recorded", rest, control, unused)

    def _build(self, params: sysid.ParameterDict, spec: mujoco.MjSpec) -> mujoco.MjModel:
        parameters = self._physical(params["theta"].value)
        set_parameters(spec, dict(zip(NAMES, parameters.tolist(), strict=True)))
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[6] = self._arms[spec.modelname].rest_angle
        mujoco.mj_forward(model, data)
        # Springs loaded so that the plant rests where it starts.
        model.qpos_spring[:6] = data.qfrc_bias[:6] / parameters[STIFFNESS]
        return model

    def _compare(
        self,
        params: sysid.ParameterDict,
        predicted: sysid.TimeSeries,
        measured: sysid.TimeSeries,
        model: mujoco.MjModel,
        return_all: bool,
        state: FloatArray,
        **_: Any,
    ) -> tuple[FloatArray, sysid.TimeSeries, sysid.TimeSeries]:
        """Return the residuals over the noise's deviation."""
        mode = model.names.split(b"\0")[0].decode()  # the first name is the model's own
        recorded = self._measured[mode]
        outputs = self._outputs(mode, state, np.asarray(predicted.data), len(recorded))
        return ((outputs - recorded) / self._sigma).ravel(), measured, measured

    def _outputs(self, mode: str, state: FloatArray, sensed: FloatArray, count: int) -> FloatArray:
        """Return (count, 24) deviations from rest; a sensor's row is a step behind the state's."""
        samples = self._substeps * np.arange(1, count + 1)
        rows, sensed = state[samples - 1], sensed[samples]
        position, velocity = rows[:, 1:8], rows[:, 8:15]
        turn = Rotation.from_rotvec(position[:, 6:7] * mode_axes(mode)[0])
        to_base = turn.as_matrix() @ mode_axes(mode)[1]
        outputs = np.empty((count, CHANNELS))
        outputs[:, SIGNALS["displacement"]] = position[:, :3]
        outputs[:, SIGNALS["velocity"]] = velocity[:, :3]
        outputs[:, SIGNALS["acceleration"]] = sensed[:, 6:9] - [0.0, 0.0, GRAVITY]
        outputs[:, SIGNALS["angles"]] = position[:, 3:6]
        outputs[:, SIGNALS["angle_rates"]] = velocity[:, 3:6]
        outputs[:, SIGNALS["angle_accelerations"]] = _hinge_accelerations(
            position[:, 3:6], velocity[:, 3:6], sensed[:, 9:12]
        )
        weight = np.array([0.0, 0.0, self._arms[mode].mass * GRAVITY])
        force = np.einsum("nij,nj->ni", to_base, sensed[:, 0:3])
        outputs[:, SIGNALS["force"]] = force - weight
        moment = np.einsum("nij,nj->ni", to_base, sensed[:, 3:6])
        rest_moment = np.cross(self._arms[mode].rest_centre(), weight)
        outputs[:, SIGNALS["moment"]] = moment - rest_moment
        return outputs


def _hinge_accelerations(angles: FloatArray, rates: FloatArray, angular: FloatArray) -> FloatArray:
    """Return hinge accelerations (n, 3) from the base's angular acceleration in world axes.

    omega = x p' + y q' + z s', where q's axis turns with p and s' axis with p and q.
    """
    (sx, sy), (cx, cy) = np.sin(angles[:, :2].T), np.cos(angles[:, :2].T)
    zero, one = np.zeros_like(sx), np.ones_like(sx)
    axes = np.array([[one, zero, sy], [zero, cx, -sx * cy], [zero, sx, cx * cy]])
    axes = np.moveaxis(axes, 2, 0)
    first = rates[:, :1] * axes[:, :, 0]
    second = first + rates[:, 1:2] * axes[:, :, 1]
    bias = rates[:, 1:2] * np.cross(first, axes[:, :, 1])
    bias += rates[:, 2:3] * np.cross(second, axes[:, :, 2])
    solved = np.linalg.solve(axes, (angular - bias)[:, :, None])
    return solved[:, :, 0].astype(np.float64)


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


def fit_ours(recording: Recording, arms: Mapping[str, ArmOnMount]) -> FloatArray:
    """Return our estimate (22,): window after window from the prior, as on a robot, then fitted."""
    search = OutputError(arms)
    for motions, outputs in zip(recording.windows, recording.outputs, strict=True):
        search.add({mode: Window(motions[mode], outputs[mode], recording.sigma) for mode in arms})
    return search.fit().parameters


def peer_optimum(
    recording: Recording, arms: Mapping[str, ArmOnMount], substeps: int, near: FloatArray
) -> FloatArray:
    """Return the parameters (22,) of the peer's least cost, which it finds without a limit on time.

    Args:
        recording: Recorded data.
        arms: Model of the arm in each mode.
        substeps: Number of the peer's physics steps a sample.
        near: (22,) initial physical parameters.

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
        theta = theta + physical_step(theta, step)
        if gain < SETTLED:
            return from_coordinates(theta)
    raise ExperimentError(f"the peer's cost still falls by {gain:.1g} after {SETTLING} steps")


def bench_identification(options: Options, output: Output) -> None:
    """Fit the same data by our estimator and by the peer, each at its best.

    Args:
        options: ``quick`` records 0.8 s instead of 4 s, for both; ``seeds`` repetitions (4 of the
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
    """Measure the time of both searches, and the errors of what they find."""
    truth = from_mapping(TABLE_2_1_TRUTH)
    rows: list[tuple[float, float, float]] = []
    for recording in recordings:
        start = time.process_time()
        ours = fit_ours(recording, arms)
        ours_seconds = time.process_time() - start
        peer, peer_seconds = SysidPeer(
            recording.motions(), recording.joined(), recording.sigma, arms, Prior()
        ).fit(ITERATIONS)
        excess = average_error_percent(ours, truth) - average_error_percent(peer, truth)
        rows.append((ours_seconds, peer_seconds, excess))
    columns = np.transpose(rows)
    names = ("ours_cpu_s", "sysid_cpu_s", "searched_excess_percent")
    for name, values in zip(names, columns, strict=True):
        output.measure(f"sysid/{name}", distribution(values))
    ratio = distribution(columns[0] / columns[1])
    output.measure("sysid_time_ratio", ratio)
    text = "identification, time over that of mujoco.sysid"
    output.check(text, ratio["median"], f"<= {TIME_BOUND:g}", ratio["median"] <= TIME_BOUND)


def _compare_errors(
    recordings: list[Recording], arms: Mapping[str, ArmOnMount], output: Output
) -> None:
    """Measure both errors where each side's cost is least.

    The data are those of a plant that neither side integrates alike, and those of the peer's steps.
    """
    truth = from_mapping(TABLE_2_1_TRUTH)
    kinds = {"": FINE_SUBSTEPS, "shared_step/": PEER_SUBSTEPS}
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
        ratio = distribution(ours / peer)
        output.measure(f"sysid_error_ratio{kind and '/shared_step'}", ratio)
        # Both seek the same optimum, so chance decides on which side of 1 the median lies.
        text = f"identification, error over that of mujoco.sysid{kind and ', its own steps'}"
        bound = f"<= {ERROR_BOUND:g} within its interval"
        output.check(text, ratio["median"], bound, ratio["low"] <= ERROR_BOUND)
        if not kind:
            high, bound = ratio["high"], f"<= {LARGEST_EXCESS:g}"
            output.check(f"{text}, upper end", high, bound, high <= LARGEST_EXCESS)
