"""On-line identification: each window's measurements decide the arm's motion in the next."""

import dataclasses
import time
from collections.abc import Mapping

import numpy as np

from controllers.identification import EXCITATIONS
from controllers.identification.arm_motion import (
    CONSTANT,
    MODES,
    ArmLimits,
    ArmState,
    RigidArm,
    Trajectory,
    swing,
)
from controllers.identification.compliant_base import ArmOnMount
from controllers.identification.excitation import (
    CRITERIA,
    REPLAN_PERIOD,
    EstimationState,
    Planner,
    random_excitation,
)
from controllers.identification.linear_estimators import KalmanFilter, pseudo_inverse, regressor
from controllers.identification.output_error import Estimate, OutputError, Window
from controllers.identification.parameters import COUNT, Prior
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_choice


@dataclasses.dataclass(frozen=True)
class IdentifierConfig:
    """Configuration of an identification.

    Attributes:
        excitation: One of `EXCITATIONS`.
        arm: The arm, whose own parameters are known (Thesis eq. 2-1, 'knowns').
        limits: Limits of the arm's motion.
        prior: Prior of the 22 parameters.
        time_step: Sampling time [s].
        rest_angle: Arm angle at which the robot came to rest [rad].
        modes: The rotations used, of `arm_motion.MODES`.
    """

    excitation: str = "information"
    arm: RigidArm = RigidArm()
    limits: ArmLimits = ArmLimits()
    prior: Prior = Prior()
    time_step: float = 0.005
    rest_angle: float = np.pi / 4
    modes: tuple[str, ...] = MODES

    def __post_init__(self) -> None:
        """Refuse an unknown excitation.

        Raises:
            ValueError: Naming the excitation and those that there are.
        """
        check_choice("excitation", self.excitation, EXCITATIONS)


class Identifier:
    """Plans windows of arm motion and estimates from what was measured in them.

    Args:
        config: Arm, excitation, prior and sampling.
        generator: Random generator of the planner's starting points and of random excitations.

    Attributes:
        excitations: Excitation of each mode in the present window.
        kalman: The plain Kalman filter of the thesis.
        plan_seconds: Time that each plan took [s].
        estimate_seconds: Time that each on-line update of the estimate took [s].
    """

    def __init__(self, config: IdentifierConfig, generator: np.random.Generator) -> None:
        self._config = config
        self._generator = generator
        self.steps = round(REPLAN_PERIOD / config.time_step)
        arms = {m: ArmOnMount.of(config.arm, m, config.rest_angle) for m in config.modes}
        self._arms = arms
        self._fit = OutputError(arms, config.prior)
        self.kalman = KalmanFilter.from_prior(config.prior)
        self._square = np.zeros((COUNT, COUNT))
        self._raw_square = np.zeros((COUNT, COUNT))
        self._product = np.zeros(COUNT)
        self._arm_states = {m: ArmState(angle=config.rest_angle) for m in config.modes}
        self.excitations = dict.fromkeys(config.modes, CONSTANT)
        self._pending: dict[str, Trajectory] = {}
        self._sigma: FloatArray | None = None
        criterion = CRITERIA.get(config.excitation)
        self._planner = None
        if criterion:
            self._planner = Planner(criterion, arms, config.limits, config.time_step, self.steps)
        self.plan_seconds: list[float] = []
        self.estimate_seconds: list[float] = []

    @property
    def estimate(self) -> Estimate:
        """Latest estimate."""
        return self._fit.estimate

    def pseudo_inverse_estimate(self) -> FloatArray:
        """Return x = (A^T A)^-1 A^T F over all samples (22,)."""
        scale = np.sqrt(np.maximum(np.diag(self._square), 1e-300))
        return pseudo_inverse(self._square / np.outer(scale, scale), self._product / scale) / scale

    def next_motion(self) -> dict[str, Trajectory]:
        """Plan the next window and return each mode's arm motion in it."""
        start = time.perf_counter()
        if self._config.excitation == "random":
            for mode in self.excitations:
                self.excitations[mode] = random_excitation(self._config.limits, self._generator)
        elif self._planner and self._sigma is not None:
            self.excitations = self._planner.plan(
                self._state(self._sigma), self.excitations, self._generator
            )
        self.plan_seconds.append(time.perf_counter() - start)
        for mode, excitation in self.excitations.items():
            self._pending[mode], self._arm_states[mode] = swing(
                self._arm_states[mode],
                excitation,
                self._config.limits,
                self.steps,
                self._config.time_step,
            )
        return dict(self._pending)

    def measured(self, outputs: Mapping[str, FloatArray], sigma: FloatArray) -> Estimate:
        """Update the estimates by the measurements of the window.

        Args:
            outputs: (n, 24) deviations from rest of each mode.
            sigma: (24,) deviations of the sensors' noise.

        Returns:
            The updated estimate.
        """
        start = time.perf_counter()
        windows = {m: Window(self._pending[m], outputs[m], sigma) for m in outputs}
        estimate = self._fit.add(windows)
        self.estimate_seconds.append(time.perf_counter() - start)
        self._sigma = sigma
        for mode, samples in outputs.items():
            matrix, right = regressor(samples, self._arms[mode])
            self.kalman.update(matrix, right, sigma[18:24])
            weight = 1 / sigma[18:24, None]
            raw = matrix.reshape(-1, COUNT)
            self._raw_square += raw.T @ raw
            rows = (matrix * weight).reshape(-1, COUNT)
            self._square += rows.T @ rows
            self._product += rows.T @ (right * weight[:, 0]).ravel()
        return estimate

    def finish(self) -> Estimate:
        """Fit all windows to convergence and return the result."""
        return self._fit.fit()

    def fit_from(self, start: FloatArray) -> Estimate:
        """Fit all windows from the search coordinates `start` (22,), and keep nothing of it."""
        return self._fit.fit_from(start)

    def _state(self, sigma: FloatArray) -> EstimationState:
        estimate = self._fit.estimate
        return EstimationState(
            parameters=estimate.parameters,
            information=estimate.physical_information(),
            sigma=sigma,
            arm_states=dict(self._arm_states),
            base_states=dict(self._fit.states),
            regressor_square=self._raw_square,
        )
