"""Identification of an unknown payload from the wrench under the arm (Thesis section 6.2 c).

The arm swings; encoders, inclinometer and the force/torque sensor under the arm are recorded. The
measured wrench minus that of the known empty arm is linear in the payload's ten inertial
parameters in the wrist's frame: w - w_arm = Y(q, q', q'', base) phi. Both sides go through the
same filter, and phi follows by weighted least squares with its
covariance. If no body could have that phi, the nearest one that a body can have is taken, nearest
in the same weights.

An arm as made weighs otherwise than its drawing by as much as a small payload, and its wrench
sensor is off by more. So it swings empty first, takes the payload, and swings alike again. What
the drawing and the calibrations leave unknown is solved for beside phi (`arm_deviations`), and is
the same in both swings.

Only sensors of the physical rover are used: neither accelerometer, nor gyro, nor heading.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from controllers.identification.arm_deviations import (
    ArmAsMade,
    ArmDeviations,
    deviation_columns,
)
from controllers.identification.arm_sensing import (
    CHANNELS,
    ArmRecord,
    IdentificationError,
    ObservationLog,
    SensingConfig,
    filter_alike,
    read_arm,
    weighed,
)
from controllers.kinematics.rigid_motion import COUNT, INERTIA_ELEMENTS, NAMES, wrench_regressor
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation

_ROUNDS = 2  # The columns of the unknowns depend on the payload: they are made anew as often.


@dataclasses.dataclass(frozen=True)
class SwingConfig:
    """Angles that the joints follow: middle + amplitude sin(2 pi frequency t), faded in.

    Attributes:
        middle: (4,) [rad].
        amplitude: (4,) [rad].
        frequency: (4,) [Hz].
        fade: Time to go from where the arm is to the full swing [s].
    """

    middle: tuple[float, ...] = (0.0, 1.1, -0.5, 0.3)
    amplitude: tuple[float, ...] = (0.7, 0.3, 0.5, 0.8)
    frequency: tuple[float, ...] = (0.15, 0.09, 0.125, 0.25)
    fade: float = 2.0


WIDE_SWING = SwingConfig(middle=(0.0, 1.3, -0.7, 0.0), amplitude=(1.4, 0.6, 0.7, 1.0))
"""A swing under which weight and moments vary apart, as telling a mass from the sensor's cross-talk
needs: half the deviation of a small payload's centre."""


@dataclasses.dataclass(frozen=True)
class PayloadIdentifierConfig:
    """Prior knowledge and settings of a payload's identification.

    Attributes:
        arm: The empty arm.
        wrench_noise: (6,) standard deviation of a wrench sample [N, N m].
        sensing: Interpretation of the measured signals.
        swing: Motion of the arm.
        window: Ticks under the filter of both sides, odd; one equation each half window.
        scales: Largest plausible mass [kg] and distance d from the wrist [m].
        resolution: The mass is identifiable when its standard deviation is below this fraction of
            the largest one; first moments and inertias when theirs are below this fraction of
            m d and m d^2, with the mass m that was found.
        deviations: What is unknown of arm and sensors; None for ones that are their drawings.
        empty: Time for which the arm swings before it takes the payload [s].
        rest: Time for which it then rests to take it [s].
    """

    arm: SerialChain
    wrench_noise: tuple[float, ...] = (0.1, 0.1, 0.1, 0.01, 0.01, 0.01)
    sensing: SensingConfig = dataclasses.field(default_factory=SensingConfig)
    swing: SwingConfig = dataclasses.field(default_factory=SwingConfig)
    window: int = 59
    scales: tuple[float, float] = (0.3, 0.15)
    resolution: float = 0.1
    deviations: ArmDeviations | None = None
    empty: float = 0.0
    rest: float = 4.0

    @property
    def taken(self) -> float:
        """Time at which the resting gripper takes the payload [s]; 0 to hold it from the start."""
        return self.empty + 0.75 * self.rest if self.empty else 0.0

    @property
    def begin(self) -> float:
        """Time at which the arm begins to swing with the payload [s]."""
        return self.empty + self.rest if self.empty else 0.0


@dataclasses.dataclass(frozen=True)
class PayloadEstimate:
    """The identified payload, in the wrist's frame.

    Attributes:
        parameters: (10,) in the order of `rigid_motion.NAMES`, of a body that can exist.
        covariance: (10, 10) of the linear estimate, from the sensor's noise and what else is
            unknown; where `chi_squared` is above 1, times that.
        linear: (10,) the linear estimate, whether or not a body can have it.
        chi_squared: Chi squared of the linear fit per degree of freedom; 1 when all is noise.
        unidentifiable: Names of parameters that the motion did not show.
        residual: (m, 6) what the fit leaves of the filtered wrench, in standard deviations; of both
            swings if there were two.
        times: (m,) of the equations [s].
    """

    parameters: FloatArray
    covariance: FloatArray
    linear: FloatArray
    chi_squared: float
    unidentifiable: tuple[str, ...]
    residual: FloatArray
    times: FloatArray

    @property
    def mass(self) -> float:
        """[kg]."""
        return float(self.parameters[0])

    @property
    def centre(self) -> FloatArray:
        """Centre of mass (3,) in the wrist's frame [m]."""
        return self.parameters[1:4] / self.parameters[0]

    @property
    def centre_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the centre of mass [m^2], to first order."""
        # Of the first moments, less what the mass alone would move them by.
        moments = (np.eye(4)[1:] - np.outer(self.centre, np.eye(4)[0])) / self.mass
        return np.asarray(moments @ self.covariance[:4, :4] @ moments.T, dtype=float)


class PayloadIdentifier:
    """Swings one robot's arm and identifies what its gripper holds.

    Args:
        robot: Name of the robot.
        config: Known arm, motion and noise.
    """

    def __init__(self, robot: str, config: PayloadIdentifierConfig) -> None:
        self._robot = robot
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        self._log = ObservationLog("payload identification", CHANNELS)
        self._empty = ObservationLog("payload identification", CHANNELS)
        self._part = -1
        self._start = np.empty(0)
        self._begin = self._since = 0.0

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Record, and swing on.

        Raises:
            IdentificationError: If a sensor that is needed is missing or reads nonsense.
        """
        seen, config = observations[self._robot], self._config
        if self._part < 0:
            self._begin = seen.time
        time = seen.time - self._begin
        # Empty, at rest, and with the payload.
        part = 2 if time >= config.begin else 1 if time >= config.empty else 0
        log = self._empty if part == 0 else self._log
        log.take(seen)
        if part != self._part:
            self._part, self._since = part, time
            self._start = seen.arm_angles.value.astype(float)
        swing = config.swing
        if part == 1:
            swing = dataclasses.replace(swing, amplitude=(0.0,) * len(swing.amplitude))
        angles, rates = swing_targets(swing, self._start, time - self._since)
        return {self._robot: Command(arm=angles, arm_mode=ArmMode.POSITION, arm_rates=rates)}

    def estimate(self) -> PayloadEstimate:
        """Return the payload, from all that was recorded once the swing had faded in.

        Raises:
            IdentificationError: If the run is too short.
        """
        config = self._config
        self._log.forget_before(self._begin + config.begin + config.swing.fade)
        if not config.empty:
            return estimate_payload(self._log, config)
        self._empty.forget_before(self._begin + config.swing.fade)
        return estimate_payload(self._log, config, self._empty)


def swing_targets(
    config: SwingConfig, start: FloatArray, time: float
) -> tuple[FloatArray, FloatArray]:
    """Return joint angles (4,) [rad] and rates (4,) [rad/s] of the swing.

    Args:
        config: Middle, amplitude and frequency of the swing.
        start: (4,) where the arm was at time zero [rad].
        time: Time since the start [s].
    """
    omega = 2.0 * np.pi * np.array(config.frequency)
    swung = np.array(config.middle) + np.array(config.amplitude) * np.sin(omega * time)
    rate = np.array(config.amplitude) * omega * np.cos(omega * time)
    done = min(1.0, time / config.fade)
    share = done**3 * (10.0 - 15.0 * done + 6.0 * done**2)
    growth = 30.0 * done**2 * (1.0 - done) ** 2 / config.fade
    return start + share * (swung - start), share * rate + growth * (swung - start)


def estimate_payload(
    log: ObservationLog, config: PayloadIdentifierConfig, empty: ObservationLog | None = None
) -> PayloadEstimate:
    """Return the payload that explains a run.

    Args:
        log: Log of the channels of `arm_sensing.CHANNELS`, with the payload.
        config: Known arm, motion and noise.
        empty: Log of the same channels without the payload; None for none.

    Raises:
        IdentificationError: If a run is too short, or does not show the mass.
    """
    swings = [(_record(log, config), True)]
    if empty is not None:
        swings.append((_record(empty, config), False))
    scales = parameter_scales(*config.scales)
    payload, excess = np.zeros(COUNT), 1.0

    def solve() -> tuple[_Solution, FloatArray]:
        parts = [_equations(record, held, payload, config) for record, held in swings]
        rows, columns, right, times = (np.concatenate(part) for part in zip(*parts))
        return _Solution.of(rows, columns, right, scales, excess), times

    for _ in range(_ROUNDS):
        solved, _ = solve()
        payload, excess = solved.linear, max(1.0, solved.chi_squared)
    return _judge(*solve(), config)


def _record(log: ObservationLog, config: PayloadIdentifierConfig) -> ArmRecord:
    """Return a swing that is long enough for two windows.

    Six numbers from one window cannot fix ten parameters; two windows leave two to judge them by.
    """
    record = read_arm(log, config.sensing)
    needed = config.window + (config.window + 1) // 2
    if len(record.times) < needed:
        raise IdentificationError(
            f"a run of {len(record.times)} ticks is too short for two windows of {config.window}; "
            f"at least {needed} are needed"
        )
    return record


def _equations(
    record: ArmRecord, held: bool, payload: FloatArray, config: PayloadIdentifierConfig
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a swing's equations rows phi + columns v = right over their noise, and their times.

    Args:
        record: Motion of the arm, and wrench.
        held: Whether it held the payload.
        payload: (10,) parameters as estimated so far.
        config: Known arm and what is unknown of it.
    """
    arm, deviations, window = config.arm, config.deviations, config.window
    columns = np.zeros((len(record.times), 6, 0))
    if deviations is not None:
        carried = float(held) * payload
        columns = deviation_columns(record, arm, carried, deviations)
        record = ArmAsMade.drawn(arm, deviations).motion(record, carried)
    motion = record.angles, record.rates, record.accelerations, record.base
    rows = float(held) * wrench_regressor(arm.last_link_motion(*motion))
    right = (record.wrench - arm.inverse_dynamics(*motion)[1])[..., None]
    return (
        weighed(rows, window, config.wrench_noise),
        weighed(columns, window, config.wrench_noise),
        weighed(right, window, config.wrench_noise)[:, 0],
        filter_alike(record.times, window, (window + 1) // 2),
    )


def parameter_scales(mass: float, distance: float) -> FloatArray:
    """Return (10,) the sizes of the parameters of a mass [kg] at a distance [m]."""
    return mass * np.array([1.0] + [distance] * 3 + [distance**2] * 6)


@dataclasses.dataclass(frozen=True)
class _Solution:
    """Solution of weighted equations, whose errors have unit variance if all is as modelled.

    Attributes:
        linear: (10,) parameters.
        information: (10, 10) of the parameters over their scales; the unknowns beside them do not
            count as known.
        chi_squared: Per degree of freedom.
        excess: Variance of the equations' errors that the information and the solution count with:
            1 or, where it is above, chi squared of an earlier solution.
        residual: (n,) what the solution leaves, in the weights given.
    """

    linear: FloatArray
    information: FloatArray
    chi_squared: float
    excess: float
    residual: FloatArray

    @classmethod
    def of(
        cls,
        rows: FloatArray,
        columns: FloatArray,
        right: FloatArray,
        scales: FloatArray,
        chi_squared: float = 1.0,
    ) -> "_Solution":
        """Solve rows phi + columns v = right, where v has unit deviations.

        Args:
            rows: (n, 10) of the parameters.
            columns: (n, k) of the unknowns beside them.
            right: (n,) right sides.
            scales: (10,) sizes of the parameters.
            chi_squared: Variance of the equations' errors by an earlier solution.
        """
        count, excess = columns.shape[1], max(1.0, chi_squared)
        scaled = rows * scales
        # Errors beyond the noise are in the equations; the unknowns keep their deviations.
        prior = np.sqrt(excess) * np.eye(count, COUNT + count, COUNT)
        solved = np.linalg.lstsq(
            np.concatenate([np.concatenate([scaled, columns], axis=1), prior]),
            np.concatenate([right, np.zeros(count)]),
            rcond=1e-9,
        )[0]
        linear, unknown = solved[:COUNT] * scales, solved[COUNT:]
        residual = right - rows @ linear - columns @ unknown
        known, shared = columns.T @ columns + excess * np.eye(count), columns.T @ scaled
        information = (scaled.T @ scaled - shared.T @ np.linalg.solve(known, shared)) / excess
        # Residual and unknowns together: as many squares as equations, less the parameters.
        squares = float(residual @ residual + excess * unknown @ unknown)
        return cls(linear, information, squares / (right.size - COUNT), excess, residual)


def _judge(
    solved: _Solution, times: FloatArray, config: PayloadIdentifierConfig
) -> PayloadEstimate:
    """Return the estimate of a solution: a body that can exist, its covariance, what is hidden."""
    mass, distance = config.scales
    scales = parameter_scales(mass, distance)
    # The unit matrix says that no parameter is larger than its scale: directions that no motion
    # showed keep that much.
    relative = np.linalg.inv(solved.information + np.eye(COUNT) / solved.excess)
    covariance: FloatArray = np.outer(scales, scales) * relative
    physical = physical_parameters(solved.linear, solved.information, scales)
    sizes = parameter_scales(max(float(physical[0]), 1e-3 * mass), distance)
    sizes[0] = mass
    sigmas = np.sqrt(np.diag(covariance)) / sizes
    hidden = tuple(
        name for name, size in zip(NAMES, sigmas, strict=True) if size > config.resolution
    )
    if "mass" in hidden:
        raise IdentificationError("the motion does not show the payload's mass")
    return PayloadEstimate(
        physical,
        covariance,
        solved.linear,
        solved.chi_squared,
        hidden,
        solved.residual.reshape(-1, 6),
        times,
    )


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return the pseudo-inertia (4, 4) of ten parameters; positive definite for a real body."""
    inertia = np.zeros((3, 3))
    for value, (row, column) in zip(parameters[4:], INERTIA_ELEMENTS, strict=True):
        inertia[row, column] = inertia[column, row] = value
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    matrix[:3, 3] = matrix[3, :3] = parameters[1:4]
    matrix[3, 3] = parameters[0]
    return matrix


def _from_pseudo_inertia(matrix: FloatArray) -> FloatArray:
    second = matrix[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    upper: Sequence[float] = [inertia[row, column] for row, column in INERTIA_ELEMENTS]
    return np.array([matrix[3, 3], *matrix[:3, 3], *upper])


def physical_parameters(
    linear: FloatArray, information: FloatArray, scales: FloatArray
) -> FloatArray:
    """Return the parameters of a body that can exist, nearest to a linear estimate.

    The pseudo-inertia is sought as L L^T with the diagonal of L positive, so that mass and all
    principal second moments are; the distance is weighted by the information.

    Args:
        linear: (10,) estimate.
        information: (10, 10) of the parameters divided by `scales`.
        scales: (10,) sizes of the parameters.
    """
    if np.all(np.linalg.eigvalsh(pseudo_inertia(linear / scales)) > 0.0):
        return linear
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, 1e-6))[:, None] * vectors.T
    target = linear / scales
    lower = np.tril_indices(4)
    diagonal = np.flatnonzero(lower[0] == lower[1])

    def parameters(coordinates: FloatArray) -> FloatArray:
        entries = coordinates.copy()
        entries[diagonal] = np.exp(np.clip(entries[diagonal], -12.0, 12.0))
        factor = np.zeros((4, 4))
        factor[lower] = entries
        return _from_pseudo_inertia(factor @ factor.T)

    sizes, axes = np.linalg.eigh(pseudo_inertia(target))
    start = np.linalg.cholesky((axes * np.maximum(sizes, 1e-3)) @ axes.T)[lower]
    start[diagonal] = np.log(start[diagonal])
    fit = least_squares(lambda x: root @ (parameters(x) - target), start, x_scale="jac")
    return parameters(fit.x) * scales
