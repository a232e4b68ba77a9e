"""The tilting table, and Table D-1 found again on it."""

import json
import math

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.appd.calibration import calibration as appd_calibration
from experiments.appd.calibration import tilt_table as appd_tilt_table
from experiments.appd.calibration.tilt_table import (
    TiltTable,
    WeighingJob,
    draw_tilts,
    true_sensors,
    weigh_one,
)
from experiments.harness.catalogue import EXPERIMENTS
from models.compose import RobotPlacement
from models.datasheets import ARM, DEGREE, INCLINOMETER_CALIBRATION
from perception.geometry.gravity import GRAVITY
from twin.connect import connect
from twin.hardware.calibration.tilt_fit import fit_tilt, up_of_tilt
from twin.realism import Realism
from twin.robot import ArmMode, Command
from twin.sensors import IDEAL


@pytest.fixture
def table():
    """A rover with perfect sensors on the table, its arm held."""
    placement = RobotPlacement("rover1", stereo=False)
    field, realism = appd_tilt_table.FIELD, Realism(IDEAL)
    with connect("sim", robots=[placement], field=field, realism=realism) as connection:
        robot = connection.robots["rover1"]
        robot.activate()
        robot.command(Command(arm=np.array(ARM.home), arm_mode=ArmMode.POSITION))
        yield TiltTable(connection.simulation, "rover1")


@pytest.fixture(scope="module")
def short_run():
    """One robot weighed at five tilts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(appd_tilt_table, "STEPS", (-12.0, 1.0, 12.0))
        patch.setattr(appd_tilt_table, "MEASURING", 1.0)
        return weigh_one(WeighingJob(5, "robot1"))


def force(table):
    return np.mean([each.arm_base_wrench.value[:3] for each in table.wait(1.0)], axis=0)


def test_rover_tilts_with_the_table_and_its_sensors_agree_with_statics(table):
    tilt = np.array([12.0, -5.0]) * DEGREE
    table.turn(tilt, 1.0)
    table.wait(1.5)
    carried = force(table)
    # The body keeps the table's tilt but for what its springs give.
    np.testing.assert_allclose(table.truth(), tilt, atol=1.0 * DEGREE)
    seen = table.wait(0.01)[0].inclinometer.value
    np.testing.assert_allclose(seen, table.truth(), atol=0.01 * DEGREE)
    np.testing.assert_allclose(carried, ARM.mass * GRAVITY * up_of_tilt(table.truth()), atol=0.01)
    table.hang(0.5)
    table.wait(1.5)
    both = force(table)
    whole = (ARM.mass + 0.5) * GRAVITY * up_of_tilt(table.truth())
    np.testing.assert_allclose(both, whole, atol=0.01)


def test_sag_under_the_weight_is_what_the_springs_of_the_rover_give(table):
    table.wait(0.5)
    before = table.truth()
    table.hang(0.5)
    table.wait(2.0)
    sag = table.truth() - before
    # Table 2-2's 317 N m/rad about the middle of the wheelbase; the tip is 0.44 m ahead of it.
    reach = 0.054 + 0.2 * math.cos(0.9) + 0.18 * math.cos(0.5) + 0.12 * math.cos(0.4)
    assert sag[0] == pytest.approx(-0.5 * GRAVITY * reach / 317.0, rel=0.1)
    assert abs(sag[1]) < 0.01 * DEGREE


def test_turning_the_table_does_not_move_the_rover(table):
    data = table._simulation.data
    table.turn(np.array([15.0, 0.0]) * DEGREE, 1.0)
    table.wait(1.0)
    table.turn(np.zeros(2), 1.0)
    table.wait(1.0)
    assert np.linalg.norm(data.qpos[:2]) < 2e-3
    np.testing.assert_allclose(table.truth()[1], 0.0, atol=1e-3)


def test_tilts_stay_in_the_linear_range_and_cover_both_axes():
    for seed in range(50):
        tilts = draw_tilts(np.random.default_rng(seed)) / DEGREE
        assert np.all(np.abs(tilts) <= 17.0)
        assert np.all(np.ptp(tilts, axis=0) >= 26.0)


def test_constants_of_table_d_1_are_found_and_the_sag_is_what_spoils_them(short_run):
    data = short_run.weighings[0]
    ours = fit_tilt(data, appd_calibration.ARM_WEIGHT)
    for line, truth in zip(ours, true_sensors("robot1")):
        assert line.zero_volts == pytest.approx(truth.zero_volts, rel=0.005)
        assert line.volts_per_radian == pytest.approx(truth.volts_per_radian, rel=0.03)
    pitch, _ = fit_tilt(data, appd_calibration.ARM_WEIGHT, without_sag=False)
    bias = (pitch.zero_volts - true_sensors("robot1")[0].zero_volts) / pitch.volts_per_radian
    # W_arm times the reach over the springs: whatever the weight.
    assert bias / DEGREE == pytest.approx(0.6, abs=0.25)


def test_finer_converter_makes_single_readings_better_and_no_finer_than_the_noise(short_run):
    coarse, fine = (np.mean(short_run.reading_rms[index]) / DEGREE for index in (0, 2))
    # 0.05 deg of noise and a count of 0.145 deg / sqrt(12).
    assert coarse == pytest.approx(math.hypot(0.05, 0.145 / math.sqrt(12)), rel=0.2)
    assert fine == pytest.approx(0.05, rel=0.15)


def test_voltages_lie_on_the_converters_grid(short_run):
    volts = np.array([weighing.after.volts for weighing in short_run.weighings[0]])
    assert np.all((volts > 1.5) & (volts < 3.3))
    same = weigh_outputs()
    np.testing.assert_allclose(same * 1024 / 5.0, np.rint(same * 1024 / 5.0), atol=1e-9)


def weigh_outputs():
    placement = RobotPlacement("rover1", stereo=False)
    with connect("sim", robots=[placement], field=appd_tilt_table.FIELD) as connection:
        seen = []
        for _ in range(10):
            connection.clock.tick()
            seen.append(connection.robots["rover1"].observe())
        return appd_tilt_table._outputs(seen, "robot1", 10)


def test_misaligned_reference_moves_the_zero_by_its_angle(short_run):
    data = short_run.weighings[0]
    pitch, roll = fit_tilt(data, appd_calibration.ARM_WEIGHT)
    angle = 1.0 * DEGREE
    turned = [appd_calibration.misaligned(each, np.array([angle, 0.0, 0.0])) for each in data]
    moved, same = fit_tilt(turned, appd_calibration.ARM_WEIGHT)
    shift = (moved.zero_volts - pitch.zero_volts) / pitch.volts_per_radian
    assert abs(shift) == pytest.approx(angle, rel=0.05)
    assert same.zero_volts == pytest.approx(roll.zero_volts, abs=2e-3)


def test_experiment_is_in_the_catalogue():
    assert EXPERIMENTS["appd-calibration"].thesis == "Table D-1"


@pytest.mark.slow
def test_quick_run_writes_everything(tmp_path):
    words = ["appd-calibration", "--quick", "--seeds", "1", "--jobs", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    folder = tmp_path / "appd-calibration"
    metrics = json.loads((folder / "metrics.json").read_text())
    for key, axes in INCLINOMETER_CALIBRATION.items():
        for axis, truth in axes.items():
            assert metrics["thesis"][f"zero_volts/{key}/{axis}"] == truth.zero_voltage
            found = metrics["measured"][f"mv_per_degree/{key}/{axis}"]["median"]
            assert found == pytest.approx(1000 * truth.sensitivity, rel=0.03)
    assert metrics["measured"]["calibration_error_percent"]["n"] == 4
    assert all(check["ok"] for check in metrics["checks"])
    assert (folder / "figures" / "table_d-1.png").is_file()
    assert (folder / "tables" / "table_d-1.csv").read_text().count("\n") == 5
