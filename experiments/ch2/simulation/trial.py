"""One identification of the simplified plant: one truth, one excitation, one noise, one seed."""

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from controllers.identification.arm_motion import CONSTANT, MODES, ArmLimits, ArmState, swing
from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.identifier import Identifier, IdentifierConfig
from controllers.identification.information import identifiability, mutual_information
from controllers.identification.parameters import NAMES, RANGES, Prior, to_coordinates
from experiments.ch2.simulation.plant import NOISE_FRACTION, Plant
from experiments.ch2.simulation.truths import average_error
from perception.geometry.arrays import BoolArray, FloatArray

DURATION = 10.0
TIME_STEP = 0.005


@dataclasses.dataclass(frozen=True)
class PlantTrial:
    """Parameters of one identification.

    Attributes:
        truth: (22,) true parameters, in the order of `parameters.NAMES`.
        excitation: One of `identifier.EXCITATIONS`.
        noise: "fixed": scaled once by the run under eq. 2-21; "relative": by this run's own
            running maximum.
        seed: Random seed of the noise and the planner.
        duration: Time of excitation [s].
        starts: Number of starts drawn from the prior from which the final fit is sought again, to
            judge it; from the truth too, if any.
    """

    truth: tuple[float, ...]
    excitation: str
    noise: str
    seed: int
    duration: float = DURATION
    starts: int = 0


def largest(outputs: Mapping[str, FloatArray]) -> FloatArray:
    """Return the greatest magnitude of each channel over samples and modes, (24,)."""
    return np.max([np.abs(samples).max(axis=0) for samples in outputs.values()], axis=0)


@functools.lru_cache(maxsize=8)
def fixed_scale(truth: tuple[float, ...], duration: float = DURATION) -> FloatArray:
    """Return what each channel senses at most under the constant excitation, (24,)."""
    values: dict[str, float] = dict(zip(NAMES, truth))
    steps = round(duration / TIME_STEP)
    motion, _ = swing(ArmState(), CONSTANT, ArmLimits(), steps, TIME_STEP)
    return largest({mode: Plant(values, mode).follow(motion) for mode in MODES})


@dataclasses.dataclass(frozen=True)
class PlantIdentification:
    """One identification of the simplified plant, compared with the truth.

    Attributes:
        truth: (22,) true parameters, SI units.
        estimates: (22,) final parameters of each estimator, SI units.
        errors: Average error of each estimator's final parameters [%].
        sigma: (22,) standard deviations of our final estimate, SI units.
        normalised_errors: (22,) errors of our final estimate over its deviations.
        told: (22,) whether the data at least halved the prior's deviation.
        chi_square: Mean squared residual over the noise's variance.
        converged: Whether our final fit says that it converged.
        missed: Sum of squares of our final fit less that of the best of the trial's other starts.
        bits: (n, 22) mutual information on each parameter at every replanning [bit].
        arm_angles: (3, m) arm angle in each mode [rad].
        plan_seconds: Time that each plan took [s].
        estimate_seconds: Time that each estimate took [s].
        histories: (n, 22) parameters of "ours" and "kalman" at every replanning, SI units.
        sigma_history: (n, 22) standard deviations of our estimate at every replanning.
        excitation_history: (n, 3, 3) offset [rad], amplitude [rad] and frequency [rad/s] of each
            mode in every window.
    """

    truth: FloatArray
    estimates: dict[str, FloatArray]
    errors: dict[str, float]
    sigma: FloatArray
    normalised_errors: FloatArray
    told: BoolArray
    chi_square: float
    converged: bool
    missed: float
    bits: FloatArray
    arm_angles: FloatArray
    plan_seconds: FloatArray
    estimate_seconds: FloatArray
    histories: dict[str, FloatArray]
    sigma_history: FloatArray
    excitation_history: FloatArray

    @property
    def nees(self) -> float:
        """Normalised squared error of our final estimate, for each parameter (1 if consistent)."""
        return float(np.mean(self.normalised_errors**2))


def run_trial(trial: PlantTrial) -> PlantIdentification:
    """Identify with all three estimators, and compare with the truth."""
    truth = np.array(trial.truth)
    values: dict[str, float] = dict(zip(NAMES, trial.truth))
    noise_generator, plan_generator, start_generator = (
        np.random.default_rng(child) for child in np.random.SeedSequence(trial.seed).spawn(3)
    )
    identifier = Identifier(IdentifierConfig(trial.excitation), plan_generator)
    plants = {mode: Plant(values, mode) for mode in MODES}
    scale = fixed_scale(trial.truth)
    running = np.zeros(24)
    ours, sigmas, kalman, excitations, arm_angles = [], [], [], [], []
    for _ in range(round(trial.duration / REPLAN_PERIOD)):
        motions = identifier.next_motion()
        clean = {mode: plants[mode].follow(motion) for mode, motion in motions.items()}
        if trial.noise == "relative":
            running = np.maximum(running, largest(clean))
            scale = running
        bound = NOISE_FRACTION * scale
        noisy = {m: y + noise_generator.uniform(-bound, bound, y.shape) for m, y in clean.items()}
        estimate = identifier.measured(noisy, bound / np.sqrt(3))
        ours.append(estimate.parameters)
        sigmas.append(np.sqrt(np.diag(estimate.covariance)))
        kalman.append(identifier.kalman.estimate.copy())
        excitations.append(list(identifier.excitations.values()))
        arm_angles.append([motion.angle[1:] for motion in motions.values()])
    final = identifier.finish()
    estimates = {
        "ours": final.parameters,
        "kalman": identifier.kalman.estimate.copy(),
        "pseudo_inverse": identifier.pseudo_inverse_estimate(),
    }
    sigma = np.sqrt(np.diag(final.covariance))
    unknown = identifiability(final).unidentifiable
    bits = [mutual_information(x, s, RANGES) for x, s in zip(ours, sigmas)]
    return PlantIdentification(
        truth=truth,
        estimates=estimates,
        errors={name: average_error(value, truth) for name, value in estimates.items()},
        sigma=sigma,
        normalised_errors=(final.parameters - truth) / sigma,
        told=np.array([name not in unknown for name in NAMES]),
        chi_square=final.chi_square,
        converged=final.converged,
        missed=missed(identifier, truth, trial.starts, start_generator),
        bits=np.array(bits),
        arm_angles=np.concatenate(arm_angles, axis=1),
        plan_seconds=np.array(identifier.plan_seconds[1:]),
        estimate_seconds=np.array(identifier.estimate_seconds),
        histories={"ours": np.array(ours), "kalman": np.array(kalman)},
        sigma_history=np.array(sigmas),
        excitation_history=np.array(excitations),
    )


def missed(
    identifier: Identifier, truth: FloatArray, starts: int, generator: np.random.Generator
) -> float:
    """Return how much less of the sum of squares a fit from elsewhere leaves; negative if more.

    Args:
        identifier: A finished identification.
        truth: (22,) true parameters, where one of the searches starts.
        starts: Number of further starts, from the prior; 0 seeks nothing and misses nothing.
        generator: Random generator of those.
    """
    if not starts:
        return 0.0
    points = [to_coordinates(truth), *(Prior().draw(generator) for _ in range(starts))]
    least = min(identifier.fit_from(point).chi_square for point in points)
    final = identifier.estimate
    return final.measurements * (final.chi_square - least)
