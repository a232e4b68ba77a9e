"""Our estimator: right, calibrated, and honest about what the data do not say."""

import dataclasses

import numpy as np
import pytest

from controllers.identification.arm_motion import (
    CONSTANT,
    MODES,
    ArmLimits,
    ArmState,
    swing,
)
from controllers.identification.compliant_base import ArmOnMount, BaseState, simulate
from controllers.identification.information import identifiability
from controllers.identification.linear_estimators import MeasurementError
from controllers.identification.output_error import (
    Estimate,
    OutputError,
    Window,
)
from controllers.identification.parameters import (
    COUNT,
    NAMES,
    Prior,
    average_error_percent,
    from_coordinates,
    to_coordinates,
)
from experiments.ch2.simulation.plant import Plant
from experiments.ch2.simulation.trial import fixed_scale
from tests.controllers.identification.recorded import (
    ARMS,
    TRUTH,
    fit,
    motion,
    noise_bound,
    noisy,
    predicted,
    recorded,
)

PATHS = {mode: motion(mode) for mode in MODES}


LIGHT_AND_STIFF = (
    *(1.888, 0.05695, 0.07346, 0.05561, -0.00108, 0.0027, -0.00471, 0.13764, -0.11205),
    *(0.07846, 63.11, 68.54, 86.27, 186.8, 105.9, 393.6),
    *(845, 2152, 1972, 3826, 1070, 5601),
)


def sigma_of(outputs: dict[str, np.ndarray], part: float = 1.0) -> np.ndarray:
    return part * noise_bound(outputs) / np.sqrt(3)


def test_mujoco_data_without_noise_give_the_truth_from_the_crude_guess():
    clean = {mode: recorded(mode) for mode in MODES}
    estimate = fit(clean, PATHS, sigma_of(clean, 0.01))
    assert average_error_percent(estimate.parameters, TRUTH) < 0.1


def test_noisy_mujoco_data_are_explained_to_the_noise():
    clean = {mode: recorded(mode) for mode in MODES}
    bound = noise_bound(clean)
    generator = np.random.default_rng(3)
    noised = {m: y + generator.uniform(-bound, bound, y.shape) for m, y in clean.items()}
    estimate = fit(noised, PATHS, bound / np.sqrt(3))
    assert estimate.trustworthy
    assert estimate.chi_square == pytest.approx(1, abs=0.02)
    deviation = np.sqrt(np.diag(estimate.covariance))
    assert np.all(np.abs(estimate.parameters - TRUTH) < 4 * deviation)
    assert np.all(np.linalg.eigvalsh(estimate.covariance) > 0)


@pytest.mark.slow
def test_final_fit_of_a_light_stiff_body_is_biased_by_less_than_its_deviation():
    """such a body swings at 50 Hz: a tenth of the noise of `ch2-simulation` shows a coarse step."""
    values = dict(zip(NAMES, LIGHT_AND_STIFF))
    paths = {mode: motion(mode, windows=15) for mode in MODES}
    clean = {mode: Plant(values, mode).follow(paths[mode]) for mode in MODES}
    sigma = 0.01 * fixed_scale(LIGHT_AND_STIFF) / np.sqrt(3)
    estimate = fit(clean, paths, sigma)
    bias = (estimate.parameters - LIGHT_AND_STIFF) / np.sqrt(np.diag(estimate.covariance))
    assert np.abs(bias).max() < 1.0


def test_result_hardly_depends_on_the_guess():
    outputs, sigma = noisy(4)
    found = []
    for guess in (Prior(), Prior(mass=2.5, damping=400, stiffness=5000)):
        search = OutputError(ARMS, guess)
        search.add({mode: Window(PATHS[mode], outputs[mode], sigma) for mode in MODES})
        found.append(search.fit())
    deviation = np.sqrt(np.diag(found[0].covariance))
    difference = np.abs(found[0].parameters - found[1].parameters) / deviation
    assert np.all(difference < 0.05)


def cut(mode: str, n: int, outputs: np.ndarray, sigma: np.ndarray) -> Window:
    """The n-th part of 80 steps."""
    path, rows = PATHS[mode], slice(80 * n, 80 * n + 81)
    steps = slice(80 * n, 80 * n + 80)
    part = path._replace(
        angle=path.angle[rows],
        rate=path.rate[rows],
        acceleration=path.acceleration[rows],
        jerk=path.jerk[steps],
    )
    return Window(part, outputs[steps], sigma)


def test_estimate_on_line_stays_near_the_final_fit():
    outputs, sigma = noisy(5)
    search = OutputError(ARMS)
    for n in range(5):
        online = search.add({mode: cut(mode, n, outputs[mode], sigma) for mode in MODES})
    final = search.fit()
    deviation = np.sqrt(np.diag(final.covariance))
    assert np.all(np.abs(online.parameters - final.parameters) < deviation)
    assert final.measurements == 3 * 400 * 24


def test_windows_that_come_after_a_fit_add_to_it():
    outputs, sigma = noisy(5, windows=2)
    after, never = OutputError(ARMS), OutputError(ARMS)
    for n in range(2):
        windows = {mode: cut(mode, n, outputs[mode], sigma) for mode in MODES}
        found = after.add(windows, relinearise=n == 0)
        never.add(windows)
        if n == 0:
            after.fit()
    final = never.fit()
    deviation = np.sqrt(np.diag(final.covariance))
    assert np.all(np.abs(found.parameters - final.parameters) < deviation)
    assert found.chi_square < 1.1
    for mode in MODES:
        end, wanted = (search.states[mode].position for search in (after, never))
        assert np.linalg.norm(end - wanted) < 0.5 * np.linalg.norm(wanted)


@pytest.mark.parametrize("greatest", [5.0, -5.0])
def test_step_is_cut_to_one_of_its_greatest_coordinate(greatest):
    here, step = Prior().mean(), np.zeros(COUNT)
    step[-2:] = greatest, -2.5
    held = OutputError(ARMS)._held(here, here + step)
    np.testing.assert_allclose(held, here + step / 5.0)
    np.testing.assert_allclose(OutputError(ARMS)._held(here, here + 0.1 * step), here + 0.1 * step)


def test_fit_that_was_cut_short_says_so_however_well_it_explains_the_data():
    outputs, sigma = noisy(5, windows=1)
    search = OutputError(ARMS)
    search.add({mode: cut(mode, 0, outputs[mode], sigma) for mode in MODES})
    *short, whole = (search.fit_from(Prior().mean(), count) for count in (*range(12), 40))
    assert whole.converged and whole.trustworthy
    excess = [fit.measurements * (fit.chi_square - whole.chi_square) for fit in short]
    assert excess[0] > 1000 and not short[0].converged
    assert all(abs(e) < 0.1 for e, fit in zip(excess, short) if fit.converged)
    deceptive = [f for f in short if abs(f.chi_square - 1) < 0.01 and not f.converged]
    assert deceptive and not any(fit.trustworthy for fit in deceptive)


def test_newton_step_left_is_what_the_cost_falls_by():
    """The gain is quadratic near the optimum: against the costs of both ends themselves."""
    outputs, sigma = noisy(5, windows=1)
    search = OutputError(ARMS)
    search.add({mode: cut(mode, 0, outputs[mode], sigma) for mode in MODES})
    whole = search.fit()
    step = 0.5 * np.sqrt(np.diag(np.linalg.inv(whole.information)))[-1]
    aside = whole.theta.copy()
    aside[-1] += step
    promised = search.fit_from(aside, 0)
    fallen = 0.5 * whole.measurements * (promised.chi_square - whole.chi_square)
    assert promised.gain_left == pytest.approx(fallen, rel=0.05)
    assert not promised.converged


STIFF_AND_HEAVY = (
    *(12.0, 1.9, 1.64, 1.7, 0.62, 0.05, -0.03, 0.2, -0.15, 0.1),
    *(60.0, 40.0, 150.0, 200.0, 300.0, 250.0),
    *(400.0, 4000.0, 1000.0, 4000.0, 400.0, 2500.0),
)
HARDLY_DAMPED = (
    *(3.0, 0.15, 0.1, 0.2, 0.0, 0.03, 0.0, 0.01, 0.3, 0.1),
    *(0.5, 0.5, 0.5, 0.2, 0.2, 0.2),
    *(1000.0, 1000.0, 500.0, 2000.0, 2500.0, 3000.0),
)


@pytest.mark.parametrize("truth", [STIFF_AND_HEAVY, HARDLY_DAMPED])
def test_on_line_estimate_follows_a_robot_unlike_the_guess(truth):
    values, search = dict(zip(NAMES, truth)), OutputError(ARMS)
    clean = {mode: Plant(values, mode).follow(PATHS[mode]) for mode in MODES}
    bound = noise_bound(clean)
    generator = np.random.default_rng(9)
    outputs = {m: y + generator.uniform(-bound, bound, y.shape) for m, y in clean.items()}
    for n in range(5):
        sigma = bound / np.sqrt(3)
        online = search.add({mode: cut(mode, n, outputs[mode], sigma) for mode in MODES})
    assert online.chi_square < 1.1


@pytest.mark.slow
@pytest.mark.parametrize("truth", [STIFF_AND_HEAVY, HARDLY_DAMPED])
def test_robot_unlike_the_guess_is_found(truth):
    values = dict(zip(NAMES, truth))
    windows = 10
    paths = {mode: motion(mode, windows) for mode in MODES}
    clean = {mode: Plant(values, mode).follow(paths[mode]) for mode in MODES}
    bound = noise_bound(clean)
    generator = np.random.default_rng(9)
    outputs = {m: y + generator.uniform(-bound, bound, y.shape) for m, y in clean.items()}
    search = OutputError(ARMS)
    search.add({m: Window(paths[m], outputs[m], bound / np.sqrt(3)) for m in MODES})
    near = search.fit()
    assert near.trustworthy
    best = search.fit_from(to_coordinates(np.array(truth)), 40)
    assert near.measurements * (near.chi_square - best.chi_square) < 0.1
    deviation = np.sqrt(np.diag(near.covariance))
    assert np.all(np.abs(near.parameters - truth) < 4.5 * deviation)


def test_physical_information_is_the_inverse_of_the_covariance():
    estimate = OutputError(ARMS).estimate
    product = estimate.physical_information() @ estimate.covariance
    np.testing.assert_allclose(product, np.eye(COUNT), atol=1e-6)
    np.testing.assert_allclose(estimate.parameters, from_coordinates(estimate.theta))


@pytest.mark.slow
def test_joint_order_that_is_not_the_plants_is_detected_by_chi_square():
    """Hinge angles read as about z, y, x: pitch and yaw of every angular channel exchanged."""
    outputs, sigma = noisy(6, windows=1)
    paths = {mode: motion(mode, windows=1) for mode in MODES}
    order = np.arange(24)
    for start in (9, 12, 15):
        order[start : start + 3] = order[start : start + 3][::-1]
    wrong = {mode: samples[:, order] for mode, samples in outputs.items()}
    estimate = fit(wrong, paths, sigma[order])
    assert not estimate.trustworthy
    assert estimate.chi_square > 1.1
    assert fit(outputs, paths, sigma).trustworthy


def test_data_of_another_arm_are_not_trusted():
    outputs, sigma = noisy(7, windows=2)
    paths = {mode: motion(mode, windows=2) for mode in MODES}
    heavier = {m: ARMS[m]._replace(mass=1.5) for m in MODES}
    assert not fit(outputs, paths, sigma, heavier).trustworthy


def test_trust_widens_only_where_data_are_few():
    base = OutputError(ARMS).estimate

    def trusted(chi_square: float, measurements: int) -> bool:
        return dataclasses.replace(
            base, chi_square=chi_square, measurements=measurements, gain_left=0.0
        ).trustworthy

    assert trusted(1.009, 10**7) and not trusted(1.011, 10**7) and not trusted(0.989, 10**7)
    assert trusted(1.04, 5760) and not trusted(1.06, 5760)
    assert not base.trustworthy  # It has seen nothing.


def unknown_after(
    paths: dict, arms: dict[str, ArmOnMount], part: float = 1.0
) -> tuple[set[str], Estimate]:
    """Names that a fit calls unidentifiable, of data with that part of the noise."""
    clean = {m: simulate(TRUTH, arms[m], paths[m], BaseState.at_rest(), False)[0] for m in arms}
    bound = part * noise_bound({mode: predicted(mode) for mode in MODES})
    generator = np.random.default_rng(8)
    outputs = {m: y + generator.uniform(-bound, bound, y.shape) for m, y in clean.items()}
    estimate = fit(outputs, paths, bound / np.sqrt(3), arms)
    return set(identifiability(estimate).unidentifiable), estimate


def test_three_modes_with_changing_excitation_leave_nothing_unidentifiable():
    unknown, estimate = unknown_after(PATHS, ARMS, part=0.05)
    assert unknown == set()
    assert identifiability(estimate).directions == ()


def test_x_mode_alone_leaves_roll_yaw_and_sideways_motion_unidentifiable():
    unknown, _ = unknown_after({"x": PATHS["x"]}, {"x": ARMS["x"]})
    assert {"kx", "bx", "k_roll", "b_roll", "k_yaw", "b_yaw", "iyy", "izz"} <= unknown
    assert not {"ky", "kz", "k_pitch"} & unknown


def test_rod_that_spins_about_itself_leaves_everything_unidentifiable():
    spinning = {"x": ARMS["x"]._replace(axis=(0.0, 1.0, 0.0))}
    unknown, estimate = unknown_after({"x": PATHS["x"]}, spinning)
    assert unknown == set(NAMES)
    assert len(identifiability(estimate).directions) == COUNT


def test_one_fixed_slow_frequency_leaves_inertia_and_a_stiffness_tied_to_it_unidentifiable():
    path, _ = swing(ArmState(), CONSTANT, ArmLimits(), 400, 0.005)
    unknown, estimate = unknown_after(dict.fromkeys(MODES, path), ARMS)
    assert {"ixx", "iyy", "izz", "rz"} & unknown
    assert not {"kx", "ky", "k_pitch", "k_roll", "k_yaw"} & unknown
    named = {name for direction in identifiability(estimate).directions for name in direction}
    assert {"ixx", "iyy", "izz"} <= named


def test_a_small_body_is_not_taken_for_an_identified_one():
    """The prior is tighter, in kg m^2, about a small inertia: that alone says nothing of it."""
    nothing = OutputError(ARMS, Prior(size=0.1)).estimate
    assert set(identifiability(nothing, Prior(size=0.1)).unidentifiable) == set(NAMES)
    theta = Prior(size=0.1).mean()
    information = Prior().term(theta)[2]
    elsewhere = dataclasses.replace(nothing, theta=theta, information=information)
    assert set(identifiability(elsewhere).unidentifiable) == set(NAMES)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_measurement_that_is_not_finite_is_named(bad):
    outputs = predicted("x").copy()
    outputs[3, 19] = bad
    with pytest.raises(MeasurementError, match="force, component 1, sample 3"):
        Window(PATHS["x"], outputs, np.ones(24))


def test_missing_channel_or_sample_is_refused():
    with pytest.raises(MeasurementError, match=r"shape \(400, 23\): expected \(400, 24\)"):
        Window(PATHS["x"], predicted("x")[:, :23], np.ones(24))
    with pytest.raises(MeasurementError, match=r"shape \(399, 24\)"):
        Window(PATHS["x"], predicted("x")[1:], np.ones(24))
    with pytest.raises(MeasurementError, match=r"sigma of shape \(6,\): expected \(24,\)"):
        Window(PATHS["x"], np.zeros((400, 24)), np.ones(6))


def test_channel_without_noise_is_refused():
    sigma = np.ones(24)
    sigma[5] = 0
    with pytest.raises(MeasurementError, match="positive deviation"):
        Window(PATHS["x"], predicted("x"), sigma)


def test_unknown_mode_is_named():
    window = Window(PATHS["x"], predicted("x"), np.ones(24))
    with pytest.raises(ValueError, match=r"modes \['w'\]: expected x, y, z"):
        OutputError(ARMS).add({"w": window})
