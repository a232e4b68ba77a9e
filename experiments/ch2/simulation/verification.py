"""Does the plant obey its equations, and what can no estimator learn from its data?"""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from controllers.identification.arm_motion import (
    CONSTANT,
    MODES,
    ArmLimits,
    ArmState,
    Excitation,
    RigidArm,
    Trajectory,
    swing,
)
from controllers.identification.compliant_base import SIGNALS, ArmOnMount, BaseState, simulate
from controllers.identification.excitation import (
    REPLAN_PERIOD,
    parameter_scale,
    random_excitation,
)
from controllers.identification.information import Identifiability, identifiability
from controllers.identification.linear_estimators import pseudo_inverse, regressor
from controllers.identification.output_error import (
    Estimate,
    OutputError,
    Window,
)
from controllers.identification.parameters import COUNT, NAMES
from experiments.ch2.simulation.plant import NOISE_FRACTION, Plant
from experiments.ch2.simulation.trial import TIME_STEP, fixed_scale
from experiments.ch2.simulation.truths import TABLE_TRUTH, Truth
from experiments.harness.contract import SweepOptions
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray

Outputs = dict[str, FloatArray]

WINDOW_STEPS = round(REPLAN_PERIOD / TIME_STEP)
WINDOWS = 10
"""Windows of a verification run: 4 s."""
EXACT_SUBSTEPS = 20
"""Integration steps a sample of the reference: 0.25 ms, order five."""

POOR_EXPERIMENTS: dict[str, tuple[str, ...]] = {
    "x_mode_alone": ("iyy", "iyz"),
    "spin_about_itself": ("ixx", "izz", "by", "ky"),
    "one_frequency": ("ixx", "iyy", "izz"),
}
"""Experiments that leave parameters unknown, and some that they must leave: nothing turns the base
about y or z, nothing moves it but about the rod, or inertia cannot be separated from stiffness.
What hardly moves may resonate, for all that the data say, with a bit of the noise: springs and
dampers of such motion are not asked for here."""
JOINT_ORDERS = {"right_order": True, "axes_exchanged": False, "hinges_outermost": False}
"""Orders of the base's joints in the data, and whether a fit may be trusted."""
CASES = ("exactness", *POOR_EXPERIMENTS, *JOINT_ORDERS)


@dataclasses.dataclass(frozen=True)
class Swings:
    """One arm motion in several modes, window after window."""

    arms: Mapping[str, ArmOnMount]
    motions: Mapping[str, list[Trajectory]]


def random_motion(generator: np.random.Generator) -> Callable[[], Excitation]:
    """Return a source of feasible excitations that change from window to window."""
    return lambda: random_excitation(ArmLimits(), generator)


def swings(
    arms: Mapping[str, ArmOnMount], source: Callable[[], Excitation], windows: int = WINDOWS
) -> Swings:
    """Move every arm through windows of excitation from static rest.

    Args:
        arms: Arm in each mode, by mode name.
        source: Gives each window's excitation.
        windows: Number of windows.
    """
    motions: dict[str, list[Trajectory]] = {}
    for mode in arms:
        state = ArmState()
        motions[mode] = []
        for _ in range(windows):
            motion, state = swing(state, source(), ArmLimits(), WINDOW_STEPS, TIME_STEP)
            motions[mode].append(motion)
    return Swings(arms, motions)


def arms_in(modes: tuple[str, ...]) -> dict[str, ArmOnMount]:
    """Return the thesis' arm in each mode."""
    return {mode: ArmOnMount.of(RigidArm(), mode) for mode in modes}


def spinning_arm() -> ArmOnMount:
    """Return the rod held forward and turned about itself, by the literal y mode."""
    along_rod = ArmOnMount.of(RigidArm(), "x")
    return along_rod._replace(axis=(0.0, 1.0, 0.0))


def from_plant(truth: Truth, run: Swings, hinges_outermost: bool = False) -> Outputs:
    """Return what the MuJoCo plant does, free of noise."""
    values: dict[str, float] = dict(zip(NAMES, truth))
    outputs = {}
    for mode, motions in run.motions.items():
        plant = Plant(values, mode, hinges_outermost=hinges_outermost)
        outputs[mode] = np.concatenate([plant.follow(motion) for motion in motions])
    return outputs


def from_equations(truth: Truth, run: Swings, substeps: int = EXACT_SUBSTEPS) -> Outputs:
    """Return the outputs by the Newton-Euler equations, finely integrated, free of noise."""
    outputs = {}
    for mode, motions in run.motions.items():
        state, rows = BaseState.at_rest(), []
        for motion in motions:
            samples, _, state = simulate(
                np.array(truth), run.arms[mode], motion, state, False, substeps
            )
            rows.append(samples)
        outputs[mode] = np.concatenate(rows)
    return outputs


def regression_error(truth: Truth, run: Swings, outputs: Outputs) -> float:
    """Return the worst error of any parameter by least squares on noise-free data [%]."""
    parts = [regressor(outputs[mode], run.arms[mode]) for mode in outputs]
    matrix = np.concatenate([part[0].reshape(-1, COUNT) for part in parts])
    right = np.concatenate([part[1].ravel() for part in parts])
    scale = np.linalg.norm(matrix, axis=0)
    estimate = pseudo_inverse(matrix / scale, right) / scale
    values = np.array(truth)
    return float(100 * np.max(np.abs(estimate - values) / parameter_scale(values)))


def agreement(plant: Outputs, equations: Outputs) -> dict[str, float]:
    """Return the relative r.m.s. difference of each signal, over all modes."""
    one, other = (np.concatenate(list(each.values())) for each in (plant, equations))
    return {
        name: float(np.linalg.norm(one[:, rows] - other[:, rows]) / np.linalg.norm(other[:, rows]))
        for name, rows in SIGNALS.items()
    }


def fitted(run: Swings, outputs: Outputs, generator: np.random.Generator) -> Estimate:
    """Fit outputs with 10 % noise of the fixed range on them.

    Args:
        run: Motion of the arms.
        outputs: Noise-free samples of each mode.
        generator: Random generator for the noise.
    """
    bound = NOISE_FRACTION * fixed_scale(TABLE_TRUTH)
    fit = OutputError(run.arms)
    for window in range(len(next(iter(run.motions.values())))):
        rows = slice(window * WINDOW_STEPS, (window + 1) * WINDOW_STEPS)
        measured = {}
        for mode, motions in run.motions.items():
            clean = outputs[mode][rows]
            noisy = clean + generator.uniform(-bound, bound, clean.shape)
            measured[mode] = Window(motions[window], noisy, bound / np.sqrt(3))
        fit.add(measured, relinearise=False)
    return fit.fit()


def unidentifiable(case: str, seed: int) -> Identifiability:
    """Return what a poor experiment leaves unknown.

    Args:
        case: One of `POOR_EXPERIMENTS`.
        seed: Root of the randomness.
    """
    generator = np.random.default_rng([seed, 3])
    arms = {"x_mode_alone": arms_in(("x",)), "spin_about_itself": {"y": spinning_arm()}}
    source = (lambda: CONSTANT) if case == "one_frequency" else random_motion(generator)
    run = swings(arms.get(case) or arms_in(MODES), source)
    return identifiability(fitted(run, from_equations(TABLE_TRUTH, run, substeps=4), generator))


def fit_order(case: str, seed: int) -> Estimate:
    """Fit data whose joints may not be in the order that the estimator assumes.

    Args:
        case: One of `JOINT_ORDERS`.
        seed: Root of the randomness; every case has the same motion and noise.
    """
    run = swings(arms_in(MODES), random_motion(np.random.default_rng([seed, 4])), WINDOWS // 2)
    data = from_plant(TABLE_TRUTH, run, hinges_outermost=case == "hinges_outermost")
    if case == "axes_exchanged":
        order = np.arange(24)
        for name in ("angles", "angle_rates", "angle_accelerations"):
            order[SIGNALS[name]] = order[SIGNALS[name]][::-1]
        data = {mode: rows[:, order] for mode, rows in data.items()}
    return fitted(run, data, np.random.default_rng([seed, 5]))


@dataclasses.dataclass(frozen=True)
class Proof:
    """What one case of the verification shows; each case fills its own part.

    Attributes:
        error: Worst error of a regression on noise-free samples [%].
        difference: Relative difference of the plant and its equations, by signal.
        unidentifiable: Names of the parameters that a poor experiment leaves unknown.
        directions: Combinations of parameters that it leaves unknown, as text.
        chi_square: Mean squared residual of a fit over the noise's variance.
        trustworthy: Whether the estimator trusts its own fit.
    """

    error: float = 0.0
    difference: dict[str, float] = dataclasses.field(default_factory=dict)
    unidentifiable: tuple[str, ...] = ()
    directions: tuple[str, ...] = ()
    chi_square: float = 0.0
    trustworthy: bool = False


def verification(config: tuple[str, int]) -> Proof:
    """Run one case; a job of the sweep.

    Args:
        config: The case, one of `CASES`, and the random seed.
    """
    case, seed = config
    if case in POOR_EXPERIMENTS:
        found = unidentifiable(case, seed)
        texts = tuple(direction_text(direction) for direction in found.directions)
        return Proof(unidentifiable=tuple(found.unidentifiable), directions=texts)
    if case in JOINT_ORDERS:
        fit = fit_order(case, seed)
        return Proof(chi_square=fit.chi_square, trustworthy=bool(fit.trustworthy))
    run = swings(arms_in(MODES), random_motion(np.random.default_rng([seed, 2])))
    plant = from_plant(TABLE_TRUTH, run)
    difference = agreement(plant, from_equations(TABLE_TRUTH, run))
    return Proof(error=regression_error(TABLE_TRUTH, run, plant), difference=difference)


def verify(options: SweepOptions, output: Output) -> None:
    """Measure and check what does not depend on the trials.

    Args:
        options: SweepOptions of the run.
        output: Output that receives metrics and checks.
    """
    configs = [(case, options.seed) for case in CASES]
    results = dict(zip(CASES, sweep(verification, configs, options, output, label="proofs")))
    exact = results["exactness"]
    error = exact.error
    output.measure("noise_free_error_percent", error)
    output.check("noise_free_error_percent, worst parameter", error, "<= 0.001", error <= 1e-3)
    for name, value in exact.difference.items():
        output.measure(f"plant_disagreement/{name}", value)
        bound = 1e-3 if name == "angle_accelerations" else 1e-4
        output.check(f"plant_disagreement/{name}", value, f"<= {bound:g}", value <= bound)
    for case, expected in POOR_EXPERIMENTS.items():
        names = results[case].unidentifiable
        output.measure(f"unidentifiable/{case}", names)
        output.measure(f"unidentifiable_directions/{case}", results[case].directions)
        named = sum(name in names for name in expected)
        label = f"unidentifiable/{case}: {', '.join(expected)} named"
        output.check(label, named, f">= {len(expected)}", named == len(expected))
    for case, trusted in JOINT_ORDERS.items():
        chi_square = results[case].chi_square
        output.measure(f"chi_square_of/{case}", chi_square)
        bound = "trusted" if trusted else "refused"
        output.check(
            f"chi_square_of/{case}", chi_square, bound, results[case].trustworthy == trusted
        )


def direction_text(direction: Mapping[str, float]) -> str:
    """Return a direction as a sum, for instance "0.71 kx - 0.70 ixx"."""
    terms = " ".join(f"{weight:+.2f} {name}" for name, weight in direction.items())
    return terms.removeprefix("+")
