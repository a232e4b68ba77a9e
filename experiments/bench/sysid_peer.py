"""The chapter 2 plant as ``mujoco.sysid`` identifies it: MuJoCo's own toolbox, as a peer."""

import io
import time
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from scipy.spatial.transform import Rotation

from controllers.identification.arm_motion import Trajectory, mode_axes
from controllers.identification.compliant_base import CHANNELS, SIGNALS, ArmOnMount
from controllers.identification.parameters import (
    INERTIA_ELEMENTS,
    LEVER,
    NAMES,
    STIFFNESS,
    Prior,
    from_coordinates,
    second_moments,
)
from models.compliant_base.build import hold_arm, set_parameters
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

SUBSTEPS = 10
"""Physics steps a sample: 0.5 ms, the longest that the stiff compliance bears."""
SMALLEST_GAIN = 1e-3
"""Gain of half the squared residuals at which our estimator stops."""
_LOWER = np.tril_indices(3)
_DIAGONAL = np.equal(*_LOWER)


class SysidPeer:
    """Fits the 22 parameters by ``mujoco.sysid`` to what was recorded of all modes.

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
        substeps: int = SUBSTEPS,
    ) -> None:
        """Prepare models and data.

        Args:
            motions: Each mode's arm motion over n steps.
            outputs: Each mode's measured deviations from rest (n, 24).
            sigma: (24,) deviations of the noise.
            arms: The arm in each mode.
            prior: Where to start; it does not enter the cost.
            substeps: Physics steps a sample.
        """
        self._sigma = sigma
        self._substeps = substeps
        guess = from_coordinates(prior.mean())
        self._factor = float(np.sqrt(second_moments(guess)[0, 0]))
        self._guess = guess
        self._rest = {mode: arm.rest_angle for mode, arm in arms.items()}
        self._rest_moment = {
            mode: np.cross(arm.rest_centre(), [0.0, 0.0, arm.mass * GRAVITY])
            for mode, arm in arms.items()
        }
        self._arm_mass = {mode: arm.mass for mode, arm in arms.items()}
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
            which our own estimator stops [s]: what it polishes after that is not counted.
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

    def _sequence(self, mode: str, motion: Trajectory, outputs: FloatArray) -> sysid.ModelSequences:
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
        start[6] = self._rest[mode]
        rest = sysid.create_initial_state(model, start, np.zeros(model.nv), np.zeros(model.na))
        control = sysid.TimeSeries(step * np.arange(jerk.size), jerk[:, None])
        # The measured channels are not MuJoCo's sensors: `_compare` takes them from `_measured`.
        self._measured[mode] = outputs
        unused = sysid.TimeSeries(control.times[:1], np.zeros((1, model.nsensordata)))
        return sysid.ModelSequences(mode, spec, "recorded", rest, control, unused)

    def _build(self, params: sysid.ParameterDict, spec: mujoco.MjSpec) -> mujoco.MjModel:
        parameters = self._physical(params["theta"].value)
        set_parameters(spec, dict(zip(NAMES, parameters.tolist(), strict=True)))
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[6] = self._rest[spec.modelname]
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
        del params, return_all
        mode = _name(model)
        recorded = self._measured[mode]
        outputs = self._outputs(mode, state, np.asarray(predicted.data), len(recorded))
        residual = (outputs - recorded) / self._sigma
        return residual.ravel(), measured, measured

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
        force = np.einsum("nij,nj->ni", to_base, sensed[:, 0:3])
        outputs[:, SIGNALS["force"]] = force - [0.0, 0.0, self._arm_mass[mode] * GRAVITY]
        moment = np.einsum("nij,nj->ni", to_base, sensed[:, 3:6])
        outputs[:, SIGNALS["moment"]] = moment - self._rest_moment[mode]
        return outputs


def _name(model: mujoco.MjModel) -> str:
    """Return the model's name: which mode it is."""
    return model.names.split(b"\0")[0].decode()


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
