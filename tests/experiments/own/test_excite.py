"""``excite``: a motion within limits that tells more than a hand-made one."""

import csv
import json

import mujoco
import numpy as np
import pytest

from controllers.identification.any_model.motion import Series
from experiments.__main__ import main
from experiments.own.excite import Prior, best_shape, information_in, known_before, sensors
from experiments.own.excite_options import Options
from experiments.own.identification import load_model
from tests.experiments.own import hidden
from twin.prediction.limits import Limits, read_limits
from twin.prediction.parameters import Parameter, explicit, select

NAMES = ["joint.*.damping", "joint.*.stiffness", "body.*.mass", "delay"]
LIMITS = "[joints.root]\nposition = [-0.3, 0.3]\n[joints.rail]\nrate = 1.0\n"


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """A motion of the cart, of 3.2 s."""
    folder = tmp_path_factory.mktemp("excite")
    (folder / "limits.toml").write_text(LIMITS)
    words = ["excite", "--model", hidden.robot("cart"), "--limits", f"{folder}/limits.toml"]
    words += ["--duration", "3.2", "--generations", "2", "--parameters", *NAMES]
    assert main([*words, "--out", f"{folder}/motion.csv"]) == 0
    with (folder / "motion.csv").open() as stream:
        head, *rows = csv.reader(stream)
    assert head == ["t", "push"]
    return folder, words, np.array(rows, dtype=float)


def test_motion_keeps_to_the_limits(designed):
    _, _, rows = designed
    model = mujoco.MjModel.from_xml_path(hidden.robot("cart"))
    data = mujoco.MjData(model)
    largest = np.zeros(2)
    for stamp, command in rows:
        data.ctrl[:] = command
        while data.time < stamp + 0.001:
            mujoco.mj_step(model, data)
        largest = np.maximum(
            largest, np.abs([data.joint("root").qpos[0], data.joint("rail").qvel[0]])
        )
    assert np.all(largest < [0.305, 1.01]) and (largest / [0.3, 1.0]).max() > 0.9
    assert rows[0, 1] == rows[-1, 1] == 0.0


class Given(Series):
    """A motion that is given."""

    def commands(self, shape, stamps):
        return np.interp(stamps, *shape)[:, None]


def test_motion_tells_more_than_a_chirp_within_the_same_limits(designed):
    folder, _, rows = designed
    spec = load_model(folder.__class__(hidden.robot("cart")))
    model = spec.compile()
    options = Options(model=folder, parameters=(), out=folder / "a.csv", duration=3.2)
    parameters = select(explicit(spec), NAMES, sensors(model))
    series = Given(np.zeros(1), 3.2, 2.0)
    stamps = rows[:, 0]
    chirp = np.sin(2.0 * np.pi * (0.1 * stamps + 1.9 * stamps**2 / 6.4)) * np.minimum(stamps, 1.0)
    limits = read_limits(folder / "limits.toml", model)
    steps = np.arange(0.0, 3.2, model.opt.timestep)
    sizes = [
        size
        for size in np.geomspace(0.1, 30.0, 60)
        if limits.excess(model, series.commands((stamps, size * chirp), steps)) <= 1.0
    ]
    left = []
    for commands in (rows[:, 1], max(sizes) * chirp):
        found = information_in(
            spec, parameters, series, (stamps, commands), options, np.zeros(len(parameters))
        )
        left.append(np.trace(np.linalg.inv(found + np.eye(len(parameters)))))
    assert left[0] < 0.8 * left[1]


def known_file(path, entries, covariance):
    rows = [{"name": name, "value": value, "spread": spread} for name, value, spread in entries]
    path.write_text(json.dumps({"parameters": rows, "covariance": covariance}))
    return path


def test_what_is_known_is_taken_by_name_and_in_other_spreads(tmp_path):
    parameters = [
        Parameter("mass", "kg", 2.0, 0.3, "factor", lambda spec, value: None),
        Parameter("new", "m", 0.0, 0.1, "offset", lambda spec, value: None),
        Parameter("centre", "m", 0.1, 0.02, "offset", lambda spec, value: None),
    ]
    entries = [("centre", 0.13, 0.01), ("other", 1.0, 1.0), ("mass", 2.2, 0.3)]
    covariance = [[0.04, 0.0, 0.01], [0.0, 1.0, 0.0], [0.01, 0.0, 0.09]]
    found = known_before(known_file(tmp_path / "a.json", entries, covariance), parameters)
    np.testing.assert_allclose(found.coordinates, [np.log(1.1) / 0.3, 0.0, 1.5])
    expected = [[0.09, 0.0, 0.005], [0.0, 1.0, 0.0], [0.005, 0.0, 0.01]]
    np.testing.assert_allclose(found.covariance, expected)
    np.testing.assert_allclose(found.precision @ expected, np.eye(3), atol=1e-12)


def test_next_motion_seeks_what_the_runs_before_left_unknown(tmp_path):
    """All of the leg but the damping of its knee is known already."""
    spec = load_model(tmp_path.__class__(hidden.robot("leg")))
    model = spec.compile()
    parameters = select(explicit(spec), ["joint.*.damping", "joint.*.armature"], {})
    entries = [(each.name, each.nominal, each.spread) for each in parameters]
    sought = [each.name for each in parameters].index("joint.knee.damping")
    sizes = np.where(np.arange(len(parameters)) == sought, 1.0, 1e-6)
    file = known_file(tmp_path / "known.json", entries, np.diag(sizes).tolist())
    known = known_before(file, parameters)
    options = Options(tmp_path, (), tmp_path / "a.csv", duration=3.2, generations=1, seed=1)
    series, limits = Series(model.key_ctrl[0].copy(), 3.2, 2.0), Limits.of_model(model)
    left = []
    for before in (Prior.as_drawn(len(parameters)), known):
        shape = best_shape(
            spec, parameters, series, limits, options, lambda step, best: None, before
        )
        found = information_in(spec, parameters, series, shape, options, known.coordinates)
        left.append(np.linalg.inv(found + known.precision)[sought, sought])
    assert left[1] < 0.8 * left[0]


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["--out", "motion.txt"], 2, "--out motion.txt: expected a file .csv or .mcap"),
        (["--out", "motion.csv", "--duration", "1"], 2, "--duration: expected above 3"),
        (["--out", "motion.csv", "--home", "1", "2"], 1, "--home: 2 commands for 1 actuators"),
        (["--out", "motion.csv", "--limits", "none.toml"], 1, "none.toml: "),
        (["--out", "motion.csv", "--known", "none.json"], 1, "none.json: no result of identify: "),
    ],
)
def test_bad_input_is_one_line(words, status, message, capsys):
    known = ["excite", "--model", hidden.robot("cart"), "--parameters", "delay"]
    assert main([*known, *words]) == status
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
