"""Identification of an unknown payload from the wrench under the arm (Thesis section 6.2 c).

The arm swings; encoders, inclinometer and the force/torque sensor under the arm are recorded. The
measured wrench minus that of the known empty arm is linear in the payload's ten inertial
parameters in the wrist's frame: w - w_arm = Y(q, q', q'', base) phi. Both sides go through the
same filter, and phi follows by weighted least squares with its
covariance. If no body could have that phi, the nearest one that a body can have is taken, nearest
in the same weights.

Only sensors of the physical rover are used: neither accelerometer, nor gyro, nor heading.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from controllers.identification.arm_sensing import (
    CHANNELS,
    IdentificationError,
    ObservationLog,
    SensingConfig,
    filter_alike,
    raised_cosine,
    read_arm,
)
from controllers.kinematics.rigid_motion import COUNT, INERTIA_ELEMENTS, NAMES, wrench_regressor
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation


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
    """

    arm: SerialChain
    wrench_noise: tuple[float, ...] = (0.1, 0.1, 0.1, 0.01, 0.01, 0.01)
    sensing: SensingConfig = dataclasses.field(default_factory=SensingConfig)
    swing: SwingConfig = dataclasses.field(default_factory=SwingConfig)
    window: int = 59
    scales: tuple[float, float] = (0.3, 0.15)
    resolution: float = 0.1


@dataclasses.dataclass(frozen=True)
class PayloadEstimate:
    """The identified payload, in the wrist's frame.

    Attributes:
        parameters: (10,) in the order of `rigid_motion.NAMES`, of a body that can exist.
        covariance: (10, 10) of the linear estimate, from the sensor's noise; where `chi_squared`
            is above 1, times that.
        linear: (10,) the linear estimate, whether or not a body can have it.
        chi_squared: Chi squared of the linear fit per degree of freedom; 1 when all is noise.
        unidentifiable: Names of parameters that the motion did not show.
        residual: (m, 6) what the fit leaves of the filtered wrench, in standard deviations.
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
        self._start: FloatArray | None = None
        self._begin = 0.0

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Record, and swing on.

        Raises:
            IdentificationError: If a sensor that is needed is missing or reads nonsense.
        """
        seen = observations[self._robot]
        self._log.take(seen)
        if self._start is None:
            self._start = seen.arm_angles.value.astype(float)
            self._begin = seen.time
        angles, rates = swing_targets(self._config.swing, self._start, seen.time - self._begin)
        return {self._robot: Command(arm=angles, arm_mode=ArmMode.POSITION, arm_rates=rates)}

    def estimate(self) -> PayloadEstimate:
        """Return the payload, from all that was recorded once the swing had faded in.

        Raises:
            IdentificationError: If the run is too short.
        """
        self._log.forget_before(self._begin + self._config.swing.fade)
        return estimate_payload(self._log, self._config)


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


def estimate_payload(log: ObservationLog, config: PayloadIdentifierConfig) -> PayloadEstimate:
    """Return the payload that explains a run.

    Args:
        log: Log of the channels of `arm_sensing.CHANNELS`.
        config: Known arm, motion and noise.

    Raises:
        IdentificationError: If the run is too short, or does not show the mass.
    """
    record = read_arm(log, config.sensing)
    stride = (config.window + 1) // 2
    # Six numbers from one window cannot fix ten parameters; two windows leave two to judge them by.
    needed = config.window + stride
    if len(record.times) < needed:
        raise IdentificationError(
            f"a run of {len(record.times)} ticks is too short for two windows of {config.window}; "
            f"at least {needed} are needed"
        )
    motion = record.angles, record.rates, record.accelerations
    left, matrix, times = (
        filter_alike(values, config.window, stride)
        for values in (
            record.wrench - config.arm.inverse_dynamics(*motion, record.base)[1],
            wrench_regressor(config.arm.last_link_motion(*motion, record.base)),
            record.times,
        )
    )
    gain = float(np.sum(raised_cosine(config.window) ** 2))
    sigma = np.array(config.wrench_noise) * np.sqrt(gain)
    rows = (matrix / sigma[:, None]).reshape(-1, COUNT)
    return _solve(rows, (left / sigma).ravel(), times, config)


def parameter_scales(mass: float, distance: float) -> FloatArray:
    """Return (10,) the sizes of the parameters of a mass [kg] at a distance [m]."""
    return mass * np.array([1.0] + [distance] * 3 + [distance**2] * 6)


def _solve(
    rows: FloatArray, right: FloatArray, times: FloatArray, config: PayloadIdentifierConfig
) -> PayloadEstimate:
    """Solve the weighted equations rows phi = right, whose errors have unit variance."""
    mass, distance = config.scales
    scales = parameter_scales(mass, distance)
    scaled = rows * scales
    linear = np.linalg.lstsq(scaled, right, rcond=1e-9)[0] * scales
    information = scaled.T @ scaled
    residual = right - rows @ linear
    chi_squared = float(residual @ residual) / (residual.size - COUNT)
    # The unit matrix says that no parameter is larger than its scale: directions that no motion
    # showed keep that much.
    relative = max(1.0, chi_squared) * np.linalg.inv(information + np.eye(COUNT))
    covariance = relative * np.outer(scales, scales)
    physical = physical_parameters(linear, information, scales)
    sizes = parameter_scales(max(float(physical[0]), 1e-3 * mass), distance)
    sizes[0] = mass
    sigmas = np.sqrt(np.diag(covariance)) / sizes
    hidden = tuple(
        name for name, size in zip(NAMES, sigmas, strict=True) if size > config.resolution
    )
    if "mass" in hidden:
        raise IdentificationError("the motion does not show the payload's mass")
    return PayloadEstimate(
        physical, covariance, linear, chi_squared, hidden, residual.reshape(-1, 6), times
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
