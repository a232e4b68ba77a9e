"""``appa-truss``: its truth, its sensors, and the insertion end to end."""

import numpy as np
import pytest

from controllers.insertion.planar_grip import GripSensor, Stance
from controllers.kinematics.serial_chain import SerialChain
from experiments.appa.truss.bench import ROBOTS, TrussBench
from experiments.appa.truss.trial import TrussTrial, planar_arm, run_truss
from models.datasheets import ROVER
from models.truss import TRUSS
from perception.geometry.gravity import GRAVITY
from twin.describe import describe
from twin.sensors import IDEAL
from twin.simulation import Simulation


@pytest.fixture(scope="module")
def bench() -> TrussBench:
    made = TrussBench(0.0, 0.0)
    made.look()
    return made


def test_grips_carry_the_segments_weight_and_nothing_else(bench):
    wrenches = bench.grips()
    assert wrenches[:, 1].sum() == pytest.approx(TRUSS.mass * GRAVITY, rel=1e-3)
    assert wrenches[:, 0].sum() == pytest.approx(0.0, abs=1e-3)
    half = TRUSS.grip_span / 2.0
    moment = wrenches[:, 2].sum() + half * (wrenches[1, 1] - wrenches[0, 1])
    assert moment == pytest.approx(0.0, abs=1e-3)
    assert not bench.contact().any()


def test_sensor_under_the_arm_measures_the_wrench_of_the_gripper_on_the_segment(bench):
    simulation = Simulation(bench.model, list(ROBOTS), suite=IDEAL, data=bench.data)
    mount = (ROVER.arm_mount[1], ROVER.arm_mount[2])
    true = bench.grips()
    for index, (name, facing) in enumerate(zip(ROBOTS, (1, -1), strict=True)):
        sensor = GripSensor(SerialChain.of_robot(describe(bench.model, name)), planar_arm(), mount)
        s, z, angle = bench.place(f"{name}/chassis")
        stance = Stance((s, z), facing, facing * angle)
        felt = sensor.felt(simulation.robots[name].observe(), stance)
        np.testing.assert_allclose(felt, true[index], atol=5e-3)
    simulation.close()


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="expected one of hybrid, position_only, unguided"):
        run_truss(TrussTrial("both", 1.0, 1))


@pytest.mark.slow
def test_force_half_inserts_with_less_force_between_the_robots_than_positions():
    hybrid, rigid = (
        run_truss(TrussTrial(method, 1.0, 2)) for method in ("hybrid", "position_only")
    )
    assert hybrid.success
    assert hybrid.contact_peak < 10.0
    assert hybrid.squeeze_error_rms < 0.5 * rigid.squeeze_error_rms
