import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
import threadpoolctl
from scipy.stats import chi2

from controllers.identification.parameters import (
    COUNT,
    NAMES,
    check_physical,
    inertia_tensor,
    to_coordinates,
)
from experiments.__main__ import main
from experiments.ch2.simulation.results import errors, judge, measure, measure_times
from experiments.ch2.simulation.simulation import Options, grouped, identify, trials
from experiments.ch2.simulation.trial import PlantTrial, missed, run_trial
from experiments.ch2.simulation.truths import (
    TABLE_TRUTH,
    average_error,
    load_truth,
    random_truth,
    relative_errors,
)
from experiments.ch2.simulation.verification import (
    agreement,
    arms_in,
    direction_text,
    from_equations,
    from_plant,
    random_motion,
    regression_error,
    swings,
)
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from models.datasheets import TABLE_2_1_AVERAGE_ERROR, TABLE_2_1_CONSTANT, TABLE_2_1_VARIABLE

VALUES = dict(zip(NAMES, TABLE_TRUTH))


@pytest.fixture(autouse=True, scope="module")
def one_blas_thread():
    """The matrices are small: threads that wait for each other cost more than they save."""
    with threadpoolctl.threadpool_limits(1):
        yield


def write(folder, content, name="truth.json"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def toml(values):
    return "".join(f"{name} = {value}\n" for name, value in values.items())


def test_truth_is_read_from_json_and_toml_in_any_order(tmp_path):
    turned = dict(reversed(VALUES.items()))
    assert load_truth(write(tmp_path, turned)) == TABLE_TRUTH
    assert load_truth(write(tmp_path, {"truth": turned})) == TABLE_TRUTH
    assert load_truth(write(tmp_path, toml(VALUES), "truth.toml")) == TABLE_TRUTH
    assert load_truth(write(tmp_path, "[truth]\n" + toml(VALUES), "t.TOML")) == TABLE_TRUTH


@pytest.mark.parametrize(
    "content, message",
    [
        ("{broken", "not valid JSON"),
        ("[" * 30_000, "nested too deeply"),
        ("[" * 10**6, "too large: 1,000,000 bytes, the limit is 32,768"),
        ("\ufeff", "not valid JSON"),
        ("[1, 2]", "got a list"),
        ({**VALUES, "mass": -3.0}, "mass = -3.0: must be positive"),
        ({**VALUES, "mass": "heavy"}, "mass is a text, not a number"),
        ({**VALUES, "mass": None}, "mass is a null, not a number"),
        ({**VALUES, "mass": True}, "mass is a bool, not a number"),
        ({**VALUES, "weight": 3.0}, "unknown ['weight']"),
        ({name: VALUES[name] for name in NAMES[1:]}, "missing ['mass']"),
        ({**VALUES, "kx": 0.0}, "kx = 0.0"),
        ({**VALUES, "rx": float("nan")}, "rx is not finite"),
        ({**VALUES, "kx": float("inf")}, "kx is beyond 1e+09"),
        ({**VALUES, "kx": 10**400}, "kx is beyond 1e+09"),
        ({**VALUES, "izz": 0.3}, "no mass distribution"),
        ({**VALUES, "iyz": 0.5}, "no mass distribution"),
    ],
)
def test_bad_truth_is_one_clear_error(tmp_path, content, message):
    with pytest.raises(OptionError) as caught:
        load_truth(write(tmp_path, content))
    assert message in str(caught.value) and "--truth" in str(caught.value)


def test_missing_truth_file_and_bad_toml_are_one_clear_error(tmp_path):
    with pytest.raises(OptionError, match="No such file"):
        load_truth(tmp_path / "none.json")
    with pytest.raises(OptionError, match="not valid TOML"):
        load_truth(write(tmp_path, "mass 3", "truth.toml"))
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(OptionError, match="not valid JSON"):
        load_truth(tmp_path / "binary.json")


def test_command_line_refuses_bad_truth_with_status_2(tmp_path, capsys):
    path = write(tmp_path, {**VALUES, "mass": -3.0})
    status = main(["ch2-simulation", "--quick", "--truth", str(path), "--out", str(tmp_path)])
    message = capsys.readouterr().err
    assert status == 2 and message.count("\n") == 1 and "mass = -3.0" in message


@pytest.mark.parametrize(
    "options",
    [
        {"excitations": ("best",)},
        {"random_truth": 0},
        {"starts": -1},
        {"random_truth": 1, "truth": "x.json"},
    ],
)
def test_contradictory_options_are_refused(options):
    with pytest.raises(OptionError):
        Options(**options)


def test_random_truths_are_physical_and_different():
    generator = np.random.default_rng(5)
    truths = [random_truth(generator) for _ in range(300)]
    for truth in truths:
        check_physical(np.array(truth))
        assert 0.5 <= truth[0] <= 25.0
        principal = np.linalg.eigvalsh(inertia_tensor(np.array(truth)))
        assert principal[0] / max(truth[13:16]) >= 0.999 * 5e-5
    spans = np.max(truths, axis=0) / np.min(truths, axis=0)
    assert np.all(spans[[10, 11, 12, *range(16, COUNT)]] > 50)
    assert len(set(truths)) == 300
    assert np.all(np.std(truths, axis=0) > 0.005)


def test_average_error_of_the_thesis_rows_is_the_mean_over_the_nonzero_parameters():
    truth = np.array(TABLE_TRUTH)
    rows = [np.array([t[n] for n in NAMES]) for t in (TABLE_2_1_CONSTANT, TABLE_2_1_VARIABLE)]
    found = [average_error(row, truth) for row in rows]
    assert np.allclose(found, (110.1, 21.8), atol=0.1)
    assert not np.allclose(found, TABLE_2_1_AVERAGE_ERROR, rtol=0.01)


def test_errors_of_other_truths_have_floors():
    truth = np.array(TABLE_TRUTH)
    truth[NAMES.index("bx")] = 101.0
    estimate = truth.copy()
    estimate[NAMES.index("ixy")] += 0.015
    estimate[NAMES.index("rx")] += 0.015
    found = relative_errors(estimate, truth)
    assert np.isclose(found[NAMES.index("ixy")], 100) and np.isclose(found[NAMES.index("rx")], 50)


def test_excitations_share_truths_and_seeds():
    jobs = trials(Options(random_truth=3, quick=True))
    assert len(jobs) == 6 and len({job.truth for job in jobs}) == 3
    for first, second in zip(jobs[::2], jobs[1::2]):
        assert first == dataclasses.replace(second, excitation="constant")
    assert len({job.seed for job in jobs}) == 3
    repeated = trials(Options(random_truth=3, quick=True, seeds=2))
    assert len({job.seed for job in repeated}) == 6 and len({job.truth for job in repeated}) == 3
    assert len(trials(Options())) == 50 * 2 * 8


def test_noise_free_regression_is_exact_and_plant_agrees_with_newton_euler():
    run = swings(arms_in(("x", "y", "z")), random_motion(np.random.default_rng(1)), windows=2)
    plant = from_plant(TABLE_TRUTH, run)
    assert regression_error(TABLE_TRUTH, run, plant) < 1e-6
    difference = agreement(plant, from_equations(TABLE_TRUTH, run))
    assert difference.pop("angle_accelerations") < 1e-3
    assert max(difference.values()) < 1e-4
    outer = from_plant(TABLE_TRUTH, run, hinges_outermost=True)
    assert max(agreement(plant, outer).values()) > 1e-3


def test_direction_reads_as_a_sum():
    assert direction_text({"kx": 0.708, "ixx": -0.7}) == "0.71 kx -0.70 ixx"


def test_trial_is_reproducible_from_its_seed():
    trial = PlantTrial(TABLE_TRUTH, "information", "relative", seed=3, duration=0.8)
    one, two = run_trial(trial), run_trial(trial)
    other = run_trial(dataclasses.replace(trial, seed=4))
    for key in ("sigma", "excitation_history", "arm_angles"):
        assert np.array_equal(getattr(one, key), getattr(two, key))
        assert not np.array_equal(getattr(one, key), getattr(other, key))
    for name, estimate in one.estimates.items():
        assert np.array_equal(estimate, two.estimates[name])
        assert not np.array_equal(estimate, other.estimates[name])
    assert one.estimates["ours"].shape == (COUNT,) and len(one.plan_seconds) == 1


class Stalled:
    """An identifier whose fit stopped 12 units above what other starts find."""

    measurements = 1000

    def __init__(self):
        self.estimate = SimpleNamespace(chi_square=1.012, measurements=1000)
        self.starts = []

    def fit_from(self, start):
        self.starts.append(start)
        return SimpleNamespace(chi_square=1.0 if len(self.starts) == 3 else 1.5)


def test_fit_that_misses_a_better_one_is_told_by_other_starts():
    stalled, truth = Stalled(), np.array(TABLE_TRUTH)
    assert missed(stalled, truth, 0, np.random.default_rng(0)) == 0.0 and not stalled.starts
    assert missed(stalled, truth, 4, np.random.default_rng(0)) == pytest.approx(12.0)
    assert len(stalled.starts) == 5 and len({tuple(start) for start in stalled.starts}) == 5
    np.testing.assert_array_equal(stalled.starts[0], to_coordinates(truth))


def test_false_convergence_is_counted_and_refused(tmp_path):
    trial = run_trial(PlantTrial(TABLE_TRUTH, "constant", "fixed", seed=1, duration=0.8))
    good = dataclasses.replace(trial, converged=True, missed=8.0)
    bad = dataclasses.replace(good, missed=10.0)
    honest = dataclasses.replace(bad, converged=False)
    for found, false, share in (([good] * 3, 0, 1.0), ([good, bad, honest], 1, 2 / 3)):
        output = Output(f"with-{false}-false", Options(out=tmp_path))
        groups = {("fixed", "constant"): found}
        measure(groups, output, of_table=False)
        measure_times(found, output)
        judge(groups, output, of_table=False)
        measured = output.metrics()["measured"]
        assert measured["false_convergence"] == false
        assert measured["converged_fraction"] == pytest.approx(share)
        checks = {check["name"]: check["ok"] for check in output.metrics()["checks"]}
        assert checks["false_convergence"] == checks["converged_fraction"] == (not false)
        output.close()


@pytest.mark.slow
def test_information_beats_constant_by_far_under_fixed_noise():
    options = Options(quick=True, seeds=1)
    jobs = trials(options)
    groups = grouped(jobs, [identify(job) for job in jobs])
    constant, information = (
        errors(groups, "fixed", name, "ours") for name in ("constant", "information")
    )
    # 40 to 104 times, and 0.17 to 0.30 %, on five seeds.
    assert np.all(constant / information >= 5.0)
    assert np.all(information <= 1.0)
    every = [trial for group in groups.values() for trial in group]
    # Errors of one run go together: they count as six at least, of the 22.
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 6 * len(every)) / (6 * len(every))
    assert low < np.mean([trial.nees for trial in every]) < high
    assert all(abs(trial.chi_square - 1) <= 0.01 for trial in every)


@pytest.mark.slow
def test_scheme_holds_on_a_hidden_random_truth():
    truth = random_truth(np.random.default_rng(20021))
    result = identify(PlantTrial(truth, "information", "fixed", seed=1))
    assert result.errors["ours"] <= 2.0 and abs(result.chi_square - 1) <= 0.01
