"""Grips in the plane, hybrid control, and what master and slave do without each other."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.cooperation import (
    REPORT,
    SET_POINT,
    SLAVE_FORCES,
    Grip,
    HybridConfig,
    HybridGrip,
    _solve,
    decode,
    encode,
)
from controllers.insertion.guide import GuideConfig, Phase
from controllers.insertion.master_slave import Master, PairConfig, Slave, Stage
from controllers.insertion.planar_grip import PlanarArm, Stance
from controllers.kinematics.serial_chain import SerialChain
from experiments.appa.truss.trial import planar_arm
from models.compose import FieldConfig, RobotPlacement, make_model
from twin.describe import describe
from twin.robot import Channel, Observation, RobotError, Validity

ARM = planar_arm()
BENDS = np.array([1.1, -1.2, -0.4])
LEFT, RIGHT = Grip((-0.15, 0.06), -0.5), Grip((0.15, 0.06), 0.5)
GUIDE = GuideConfig(0.16, 0.3, 2000.0)
PAIR = PairConfig(LEFT, RIGHT, (0.0, 0.17), GUIDE, hold=0.1, carry=0.2, rest=0.1)


def measured(value):
    return Channel(np.array(value, dtype=float), 0.0, Validity.MEASURED)


def seen(bends=BENDS):
    return Observation(0.0, arm_angles=measured([0.0, *bends]), inclinometer=measured([0.02, 0.0]))


class Spring:
    """Stands for the grip's sensor: what is held pulls the gripper back to a place."""

    def __init__(self, place, stiffness):
        self.place, self.stiffness = np.array(place), np.array(stiffness)
        self.pose, self.blind = np.array(place), False

    def felt(self, observation, stance):
        return None if self.blind else self.stiffness * (self.pose - self.place)


def follow(grip, spring, target, ticks, rate=(0.0, 0.0, 0.0), bends=BENDS):
    """Let a grip act on the spring; the servo is perfect."""
    target = np.array(target, dtype=float)
    for _ in range(ticks):
        grip.feel(seen(bends))
        command = grip.command(target, np.array(rate))
        spring.pose = grip.stance.to_plan(ARM.task(command.arm[1:]))
    return spring.pose


def hybrid(facing=-1, stiffness=(2000.0, 1500.0, 100.0), **changes):
    """A grip that holds on to a spring where it starts."""
    stance = Stance((0.55, 0.06), facing)
    spring = Spring(stance.to_plan(ARM.task(BENDS)), stiffness)
    config = HybridConfig(SLAVE_FORCES, (-1.0, 0.0, 0.0), **changes)
    grip = HybridGrip(config, ARM, spring, stance)
    grip.hold(seen())
    grip.start(0.0)
    return grip, spring


def test_planar_arm_is_the_spatial_arm_at_zero_yaw():
    model = make_model(FieldConfig(texture_pixels=16), [RobotPlacement("rover1")])
    grip = RigidTransform.from_translation([0.0, 0.12, 0.0])
    arm = describe(model, "rover1").arm
    assert arm is not None
    spatial = SerialChain.from_description(arm, grip)
    for bends in np.random.default_rng(1).uniform(-1.5, 1.5, (10, 3)):
        place = spatial.tool_in_robot([0.0, *bends]).translation
        np.testing.assert_allclose(ARM.task(bends), [*place[1:], bends.sum()], atol=1e-9)
        columns = spatial.jacobian([0.0, *bends])[1:4, 1:]
        np.testing.assert_allclose(ARM.jacobian(bends), columns, atol=1e-9)


@pytest.mark.parametrize("facing", [1, -1])
def test_stance_takes_poses_there_and_back_and_rates_as_differences(facing):
    stance = Stance((0.3, 0.07), facing, tilt=0.1)
    task, motion, small = np.array([0.4, 0.1, -0.5]), np.array([0.02, -0.03, 0.05]), 1e-6
    pose = stance.to_plan(task)
    np.testing.assert_allclose(stance.to_robot(pose), task, atol=1e-14)
    rate = (stance.to_plan(task + small * motion) - pose) / small
    np.testing.assert_allclose(stance.rate_to_robot(rate), motion, atol=1e-8)
    assert pose[2] == pytest.approx(facing * (-0.5 + 0.1))
    with pytest.raises(ValueError, match="facing 0"):
        Stance((0.0, 0.0), 0)


def test_grip_undoes_itself_and_its_wrench_does_the_work_of_the_segments():
    segment, rate = np.array([0.01, 0.2, 0.15]), np.array([0.3, -0.2, 0.4])
    pose = RIGHT.on(segment)
    np.testing.assert_allclose(RIGHT.segment_of(pose), segment, atol=1e-14)
    moved = (RIGHT.on(segment + 1e-6 * rate) - pose) / 1e-6
    np.testing.assert_allclose(RIGHT.rate_on(segment, rate), moved, atol=1e-6)
    wrench = np.array([2.0, -1.0, 0.3])
    power = RIGHT.about_segment(wrench, segment[2]) @ rate
    assert wrench @ RIGHT.rate_on(segment, rate) == pytest.approx(power)


def test_messages_come_back_to_their_resolution_and_others_are_refused():
    pose = np.array([-0.123456, 0.171234, 0.034567, 0.008123, -0.006543, 0.0123])
    message = encode(SET_POINT, pose)
    assert len(message) == 13
    kind, values = decode(message)
    assert kind == SET_POINT
    np.testing.assert_allclose(values, pose, atol=2.5e-5)
    assert decode(encode(REPORT, [1e6, -1.5, 0.2]))[1] == pytest.approx([65.534, -1.5, 0.2])
    for bad in (b"", b"\x07abc", message[:-1]):
        with pytest.raises(ValueError, match="neither a set point nor a report"):
            decode(bad)
    with pytest.raises(ValueError, match="finite"):
        encode(REPORT, [np.nan, 0.0, 0.0])


@pytest.mark.parametrize("facing", [1, -1])
def test_hybrid_grip_reaches_wanted_forces_and_planned_position(facing):
    grip, spring = hybrid(facing)
    target = spring.place + [0.004, -0.006, 0.02]
    pose = follow(grip, spring, target, 300)
    wrench = spring.felt(None, None)
    assert wrench[0] == pytest.approx(-1.0, abs=0.01)
    assert wrench[2] == pytest.approx(0.0, abs=0.01)
    assert pose[1] == pytest.approx(target[1], abs=1e-5)


def test_without_force_control_the_grip_follows_the_planned_path():
    grip, spring = hybrid()
    grip = HybridGrip(HybridConfig((False,) * 3), ARM, spring, grip.stance)
    grip.hold(seen())
    grip.start(0.0)
    target = spring.place + [0.004, -0.006, 0.02]
    np.testing.assert_allclose(follow(grip, spring, target, 300), target, atol=1e-5)


def test_without_a_wrench_the_forces_corrections_stay():
    grip, spring = hybrid()
    before = follow(grip, spring, spring.place, 200)
    spring.blind = True
    after = follow(grip, spring, spring.place, 200)
    np.testing.assert_allclose(after, before, atol=1e-6)


def test_grip_yields_no_further_than_its_reach():
    grip, spring = hybrid(stiffness=(0.0, 0.0, 0.0), give=0.02)  # nothing there to press on
    pose = follow(grip, spring, spring.place, 150)
    assert pose[0] - spring.place[0] == pytest.approx(-HybridConfig(SLAVE_FORCES).reach, abs=1e-5)


def test_grip_refuses_to_start_blind_or_to_be_driven_before():
    spring = Spring(np.zeros(3), np.zeros(3))
    grip = HybridGrip(HybridConfig(SLAVE_FORCES), ARM, spring, Stance((0.0, 0.0), 1))
    with pytest.raises(RobotError, match="arm_angles, which is missing"):
        grip.hold(Observation(0.0))
    with pytest.raises(RobotError, match="before it held"):
        grip.start(0.0)
    with pytest.raises(RobotError, match="before it was started"):
        grip.command(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="give = 0"):
        HybridConfig(SLAVE_FORCES, give=0.0)
    with pytest.raises(ValueError, match="every = 0"):
        PairConfig(LEFT, RIGHT, (0.0, 0.0), GUIDE, every=0)


def master_at_rest(stance):
    grip = HybridGrip(HybridConfig((False,) * 3), ARM, Spring(np.zeros(3), np.zeros(3)), stance)
    return Master(grip, PAIR)


def test_master_stops_and_gives_up_when_the_slaves_reports_cease():
    master = master_at_rest(Stance((-0.55, 0.06), 1))
    report = encode(REPORT, [0.0, 0.0, 0.0])
    for _ in range(100):
        master.step(seen(), [report])
    assert master.stage is Stage.INSERT
    for _ in range(round(PAIR.lost_time / PAIR.period) + 2):
        master.step(seen(), [])
    held = master.target.copy()
    for _ in range(round(GUIDE.lost_time / PAIR.period) + 2):
        master.step(seen(), [])
        np.testing.assert_array_equal(master.target, held)
    assert master.stage is Stage.OVER and master.guide.phase is Phase.FAILED
    assert master.guide.reason == "no wrench"


def test_slave_continues_briefly_without_set_points_and_then_holds():
    stance = Stance((0.55, 0.06), -1)
    grip = HybridGrip(HybridConfig((False,) * 3), ARM, Spring(np.zeros(3), np.zeros(3)), stance)
    slave = Slave(grip, PAIR)
    pitched = Stance(stance.place, -1, tilt=0.02)  # as `seen` has it
    segment = RIGHT.segment_of(pitched.to_plan(ARM.task(BENDS)))
    message = encode(SET_POINT, [*segment, 0.01, 0.0, 0.0])
    places = []
    for tick in range(150):
        command, _ = slave.step(seen(), [message] if tick == 20 else [])
        places.append(pitched.to_plan(ARM.task(command.arm[1:]))[0])
    assert places[100] - places[21] > 1e-3
    np.testing.assert_allclose(places[100:], places[100], atol=2e-4)


def test_planar_arm_of_one_straight_line():
    arm = PlanarArm((0.1, 0.2), (0.3, 0.2, 0.1))
    np.testing.assert_allclose(arm.task([0.0, 0.0, 0.0]), [0.7, 0.2, 0.0])
    np.testing.assert_allclose(arm.task([np.pi / 2, 0.0, 0.0]), [0.1, 0.8, np.pi / 2])


def test_joints_of_a_stretched_arm_are_damped_by_a_thousandth():
    # One singular value s gives s / (s^2 + 1e-6) of the motion.
    for small, gain in ((1e-3, 500.0), (1e-4, 99.0), (0.0, 0.0)):
        solved = _solve(np.diag([1.0, 1.0, small]), np.ones(3))
        np.testing.assert_allclose(solved, [1.0, 1.0, gain], rtol=1e-3)
