"""Planning and estimating in turn, against the plant in MuJoCo."""

import numpy as np
import pytest

from controllers.identification.arm_motion import CONSTANT, MODES, ArmLimits
from controllers.identification.identifier import EXCITATIONS, Identifier, IdentifierConfig
from controllers.identification.linear_estimators import MeasurementError
from controllers.identification.parameters import average_error_percent
from experiments.ch2.simulation.plant import Plant
from models.datasheets import TABLE_2_1_TRUTH
from tests.controllers.identification.recorded import TRUTH, noise_bound, recorded

BOUND = noise_bound({mode: recorded(mode) for mode in MODES})


def run(excitation: str, windows: int, seed: int = 0) -> Identifier:
    identifier = Identifier(IdentifierConfig(excitation), np.random.default_rng(seed))
    plants = {mode: Plant(TABLE_2_1_TRUTH, mode) for mode in MODES}
    generator = np.random.default_rng(seed + 100)
    for _ in range(windows):
        motions = identifier.next_motion()
        clean = {mode: plants[mode].follow(path) for mode, path in motions.items()}
        noisy = {m: y + generator.uniform(-BOUND, BOUND, y.shape) for m, y in clean.items()}
        identifier.measured(noisy, BOUND / np.sqrt(3))
    return identifier


def test_planned_motion_identifies_better_than_the_constant_one():
    errors = {}
    for excitation in ("constant", "information"):
        identifier = run(excitation, 6)
        final = identifier.finish()
        assert final.trustworthy
        errors[excitation] = average_error_percent(final.parameters, TRUTH)
        assert len(identifier.plan_seconds) == len(identifier.estimate_seconds) == 6
    assert errors["information"] < 0.5 * errors["constant"]


def test_first_window_is_the_constant_excitation_and_windows_join_smoothly():
    identifier = Identifier(IdentifierConfig("random"), np.random.default_rng(1))
    ends = None
    for _ in range(4):
        motions = identifier.next_motion()
        if ends is not None:
            for mode, path in motions.items():
                assert path.angle[0] == pytest.approx(ends[mode].angle[-1])
                assert path.rate[0] == pytest.approx(ends[mode].rate[-1])
                assert path.acceleration[0] == pytest.approx(ends[mode].acceleration[-1])
        ends = motions
    planned = Identifier(IdentifierConfig("information"), np.random.default_rng(1))
    planned.next_motion()
    assert planned.excitations == dict.fromkeys(MODES, CONSTANT)


def test_same_seed_gives_the_same_estimate_bit_for_bit():
    first, second = (run("information", 2, seed=3).finish() for _ in range(2))
    np.testing.assert_array_equal(first.parameters, second.parameters)


def test_linear_estimates_agree_with_each_other_where_the_prior_does_not_matter():
    identifier = run("random", 5)
    kalman, inverse = identifier.kalman.estimate, identifier.pseudo_inverse_estimate()
    np.testing.assert_allclose(kalman[16:], inverse[16:], rtol=0.02)


@pytest.mark.parametrize("excitation", [e for e in EXCITATIONS if e != "information"])
def test_every_excitation_moves_the_arm_within_its_limits(excitation):
    identifier = Identifier(IdentifierConfig(excitation), np.random.default_rng(0))
    limits = ArmLimits()
    for _ in range(2):
        motions = identifier.next_motion()
        for path in motions.values():
            assert np.abs(path.rate).max() <= limits.rate
            assert np.abs(path.acceleration).max() <= limits.acceleration
        noise = np.random.default_rng(1).normal(size=(80, 24)) * BOUND
        identifier.measured({mode: noise for mode in motions}, BOUND)


def test_unknown_excitation_is_named_with_those_that_there_are():
    with pytest.raises(ValueError, match="excitation 'wild': expected one of constant, random"):
        IdentifierConfig("wild")


def test_sample_that_is_not_a_number_is_refused_and_leaves_the_estimate_as_it_was():
    identifier = run("constant", 1)
    before = identifier.estimate
    motions = identifier.next_motion()
    bad = {mode: recorded(mode)[:80].copy() for mode in motions}
    bad["z"][5, 9] = np.nan
    with pytest.raises(MeasurementError, match="angles, component 0, sample 5 is nan"):
        identifier.measured(bad, BOUND)
    assert identifier.estimate is before
    good = {mode: recorded(mode)[:80] for mode in motions}
    identifier.measured(good, BOUND)
    assert identifier.estimate is not before
