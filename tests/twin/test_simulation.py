import mujoco
import numpy as np
import pytest

from tests.twin.scene import SERVO, compile_scene, scene_xml
from twin.loop import run
from twin.robot import (
    ArmMode,
    Command,
    Lifecycle,
    Observation,
    RobotError,
    Validity,
    WheelMode,
    applied_command,
)
from twin.sensor_bank import tilt
from twin.sensors import DATASHEET, IDEAL
from twin.simulation import Simulation

MODEL = compile_scene(("rover1",))
PAIR = compile_scene(("rover1", "rover2"))


def make(suite=IDEAL, seed=0, model=MODEL, names=("rover1",)):
    return Simulation(model, names, suite=suite, servo=SERVO, seed=seed)


class Drive:
    """Wheels at a speed and the arm on a sine, from its own clock only."""

    def __init__(self, name="rover1", speed=2.0):
        self.name, self.speed = name, speed

    def reset(self):
        pass

    def step(self, observations):
        time = observations[self.name].time
        arm = 0.4 * np.sin(3.0 * time + np.arange(4.0))
        return {
            self.name: Command(
                np.full(4, self.speed), arm, WheelMode.SPEED, ArmMode.POSITION, np.zeros(4)
            )
        }


def observations_of(simulation, controller, steps):
    robot = simulation.robots["rover1"]
    if robot.lifecycle is not Lifecycle.ACTIVE:
        robot.activate()
    seen = []
    for _ in range(steps):
        seen.append(robot.observe())
        robot.command(controller.step({"rover1": seen[-1]})["rover1"])
        simulation.tick()
    return seen


def as_bytes(observation: Observation) -> bytes:
    parts = [np.float64(observation.time).tobytes()]
    for name in observation._fields[1:]:
        channel = getattr(observation, name)
        parts += [channel.value.tobytes(), np.float64(channel.stamp).tobytes()]
        parts.append(channel.validity.value.encode())
    return b"".join(parts)


def test_split_step_equals_mj_step_bit_for_bit():
    simulation = make()
    robot = simulation.robots["rover1"]
    robot.activate()
    plain = mujoco.MjData(MODEL)
    rng = np.random.default_rng(1)
    for _ in range(50):
        duty = rng.uniform(-1, 1, 8)
        robot.command(Command(duty[:4], duty[4:]))
        simulation.tick()
        plain.ctrl[:] = 12.0 * duty
        mujoco.mj_step(MODEL, plain, 10)
        assert np.array_equal(plain.qpos, simulation.data.qpos)
        assert np.array_equal(plain.qvel, simulation.data.qvel)


def test_position_and_velocity_sensors_do_not_lag():
    simulation = make()
    robot = simulation.robots["rover1"]
    robot.activate()
    robot.command(Command(np.full(4, 0.5), np.full(4, 0.5)))
    for _ in range(7):
        simulation.tick()
    fresh = mujoco.MjData(MODEL)
    fresh.qpos[:], fresh.qvel[:] = simulation.data.qpos, simulation.data.qvel
    mujoco.mj_forward(MODEL, fresh)
    seen = robot.observe()
    assert seen.wheel_speeds.value[0] == fresh.joint("rover1/front_left_joint").qvel[0]
    assert seen.arm_angles.value[1] == fresh.joint("rover1/shoulder_joint").qpos[0]
    np.testing.assert_allclose(seen.gyro.value, fresh.sensor("rover1/gyro").data, atol=1e-15)
    assert seen.arm_angles.stamp == pytest.approx(0.07)
    assert seen.arm_base_wrench.stamp == pytest.approx(0.069)


def test_wrench_at_rest_is_the_arms_weight_upward():
    simulation = make()
    for _ in range(200):
        simulation.tick()
    force = simulation.robots["rover1"].observe().arm_base_wrench.value[:3]
    np.testing.assert_allclose(force, [0, 0, 0.4 * 9.81], atol=2e-3)


@pytest.mark.parametrize("pitch, roll, yaw", [(0.2, 0, 0), (0, 0.3, 0), (0.1, -0.2, 2.5)])
def test_tilt_inverts_the_rotation_yaw_pitch_roll(pitch, roll, yaw):
    quat = np.zeros(4)
    # Intrinsic z, then x, then y.
    mujoco.mju_euler2Quat(quat, np.array([yaw, pitch, roll]), "zxy")
    assert tilt(*quat) == pytest.approx((pitch, roll, yaw), abs=1e-12)


def test_same_seed_gives_the_same_run_bit_for_bit_and_another_does_not():
    runs = [
        [as_bytes(o) for o in observations_of(make(DATASHEET, seed), Drive(), 150)]
        for seed in (3, 3, 4)
    ]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_restored_run_continues_bit_for_bit():
    suite = DATASHEET.with_channel("gyro", delay=0.03, dropout=0.2)
    simulation = make(suite, seed=5)
    observations_of(simulation, Drive(), 80)
    saved = simulation.save()
    first = [as_bytes(o) for o in observations_of(simulation, Drive(), 80)]
    other = make(suite, seed=99)
    for target in (simulation, other):
        target.restore(saved)
        again = [as_bytes(o) for o in observations_of(target, Drive(), 80)]
        assert again == first


def test_state_of_another_scene_is_refused():
    with pytest.raises(ValueError, match="another scene"):
        make().restore(make(model=PAIR, names=("rover1", "rover2")).save())


def test_two_robots_in_one_scene_move_independently():
    simulation = make(model=PAIR, names=("rover1", "rover2"))
    summary = run(
        simulation.robots,
        [Drive("rover1", 3.0), Drive("rover2", -3.0)],
        simulation,
        duration=2.0,
    )
    assert summary.duration == pytest.approx(2.0)
    first = simulation.data.joint("rover1/root_joint").qpos[1]
    second = simulation.data.joint("rover2/root_joint").qpos[1]
    assert first > 0.15 and second < -0.15


def test_robots_of_one_scene_have_different_noise():
    simulation = make(DATASHEET, model=PAIR, names=("rover1", "rover2"))
    simulation.tick()
    one, two = (robot.observe().gyro.value for robot in simulation.robots.values())
    assert not np.any(one == two)


def test_command_returns_the_clamped_duty_and_the_motor_gets_it():
    simulation = make()
    robot = simulation.robots["rover1"]
    robot.activate()
    applied = robot.command(Command(np.array([0.5, -3.0, 2.0, 0.0])))
    np.testing.assert_array_equal(applied.wheels, [0.5, -1.0, 1.0, 0.0])
    np.testing.assert_array_equal(simulation.data.ctrl[:4], [6.0, -12.0, 12.0, 0.0])


def test_effort_mode_gives_the_asked_torque_at_the_measured_speed():
    simulation = make()
    robot = simulation.robots["rover1"]
    robot.activate()
    for _ in range(20):
        robot.command(Command(np.full(4, 0.3), wheel_mode=WheelMode.EFFORT))
        simulation.tick()
    robot.command(Command(np.full(4, 0.3), wheel_mode=WheelMode.EFFORT))
    mujoco.mj_forward(MODEL, simulation.data)
    np.testing.assert_allclose(simulation.data.actuator_force[:4], 0.3, rtol=1e-9)


def test_duty_that_is_no_number_leaves_scattered_motors_without_voltage_too():
    spec = mujoco.MjSpec.from_string(scene_xml())
    # Another actuator amid the robot's own: then the servo cannot write where the motors read.
    names = [actuator.name for actuator in spec.actuators]
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in (*names[:3], "lamp", *names[3:]):
        spec.add_actuator(
            name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=[-12, 12]
        ).target = "rover1/front_left_joint" if name == "lamp" else f"{name}_joint"
    simulation = make(model=spec.compile())
    robot = simulation.robots["rover1"]
    robot.activate()
    robot.command(Command(np.full(4, 0.5)))
    assert np.count_nonzero(simulation.data.ctrl) == 4
    with pytest.raises(ValueError, match="nan.*nothing was sent"):
        robot.command(applied_command(np.array([0.0, np.nan, 0.0, 0.0]), np.zeros(4)))
    assert not np.any(simulation.data.ctrl) and robot.lifecycle is Lifecycle.ERROR


def test_lifecycle_follows_the_contract():
    simulation = make()
    robot = simulation.robots["rover1"]
    assert robot.lifecycle is Lifecycle.INACTIVE
    robot.observe()
    with pytest.raises(RobotError, match="inactive"):
        robot.command(Command())
    robot.activate()
    robot.command(Command(np.ones(4)))
    robot.deactivate()
    assert robot.lifecycle is Lifecycle.INACTIVE
    assert not np.any(simulation.data.ctrl)
    simulation.close()
    assert robot.lifecycle is Lifecycle.UNCONFIGURED
    for call in (robot.observe, robot.activate):
        with pytest.raises(RobotError, match="unconfigured"):
            call()


def test_missing_tachometer_stops_a_speed_loop_with_all_axes_zero():
    simulation = make()
    robot = simulation.robots["rover1"]
    robot.activate()
    robot.command(Command(np.ones(4), np.ones(4), WheelMode.SPEED))
    simulation.tick()
    robot.sensors.disconnect("wheel_speeds")
    simulation.tick()
    assert robot.observe().wheel_speeds.validity is Validity.MISSING
    with pytest.raises(RobotError, match="wheel_speeds, which is missing"):
        robot.command(Command(np.ones(4), np.ones(4), WheelMode.SPEED))
    assert robot.lifecycle is Lifecycle.ERROR
    assert not np.any(simulation.data.ctrl)
    with pytest.raises(RobotError, match="error"):
        robot.command(Command())
    robot.deactivate()
    assert robot.lifecycle is Lifecycle.ERROR
    robot.activate()
    assert robot.lifecycle is Lifecycle.ACTIVE
    robot.sensors.connect("wheel_speeds")
    simulation.tick()
    robot.command(Command(np.ones(4), np.ones(4), WheelMode.SPEED))
    assert np.all(simulation.data.ctrl > 0.0)


@pytest.mark.parametrize("ticks", [0, 1, 7])
def test_divergence_puts_every_robot_in_error_with_all_axes_zero(ticks):
    simulation = make(model=PAIR, names=("rover1", "rover2"))
    for robot in simulation.robots.values():
        robot.activate()
        robot.command(Command(np.ones(4), np.ones(4)))
    for _ in range(ticks):
        simulation.tick()
    simulation.data.qvel[0] = np.nan
    with pytest.raises(RobotError, match="diverged"):
        simulation.tick()
    assert {r.lifecycle for r in simulation.robots.values()} == {Lifecycle.ERROR}
    assert not np.any(simulation.data.ctrl)


@pytest.mark.parametrize("shape", [(4, 1), (4, 2), (1, 4), ()])
def test_command_of_another_shape_is_refused_by_name(shape):
    with pytest.raises(ValueError, match="command wheels: expected numbers in a row, got shape"):
        Command(np.zeros(shape), np.zeros(4))
    with pytest.raises(ValueError, match="command arm: expected numbers in a row, got shape"):
        Command(np.zeros(4), np.zeros(shape))


@pytest.mark.parametrize("count", [1, 3, 5, 8])
def test_command_of_another_length_is_refused_by_the_robot(count):
    simulation = make()
    robot = simulation.robots["rover1"]
    for part in ("wheels", "arm", "arm_rates"):
        robot.activate()
        robot.command(Command(np.full(4, 0.5)))
        with pytest.raises(ValueError, match="the robot has 4 wheels and 4 joints"):
            robot.command(Command(**{part: np.ones(count)}))
        assert not np.any(simulation.data.ctrl) and robot.lifecycle is Lifecycle.ERROR
        with pytest.raises(RobotError, match="not active: ValueError: command with"):
            robot.command(Command())


@pytest.mark.parametrize("four", [[0, 1, 0, 1], np.array([0, 1, 0, 1]), np.float32([0, 1, 0, 1])])
def test_command_of_other_numbers_is_made_one_of_doubles(four):
    command = Command(four, np.zeros(4))
    assert command.wheels.dtype == np.float64
    np.testing.assert_array_equal(command.wheels, [0.0, 1.0, 0.0, 1.0])


def test_nan_is_refused_before_the_motors():
    with pytest.raises(ValueError, match="not finite"):
        Command(np.array([0.0, np.nan, 0.0, 0.0]))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", ["wheels", "arm", "arm_rates"])
def test_what_is_not_finite_is_refused_by_name_beside_finite_numbers(part, wrong):
    numbers = {"wheels": np.full(4, 1e308), "arm": np.full(4, 1e308), "arm_rates": np.zeros(4)}
    np.testing.assert_array_equal(Command(**numbers).arm, numbers["arm"])
    numbers[part] = np.array([0.0, 0.0, wrong, -wrong])
    with pytest.raises(ValueError, match=f"command {part}: .*not finite"):
        Command(**numbers)


@pytest.mark.parametrize("part", ["wheels", "arm", "arm_rates"])
@pytest.mark.parametrize("scale", [1.0, 1e308])
def test_command_holds_its_own_numbers_which_nobody_changes(part, scale):
    given = {name: np.full(4, scale) for name in ("wheels", "arm", "arm_rates")}
    command = Command(**given)
    given[part][2] = np.inf
    np.testing.assert_array_equal(getattr(command, part), np.full(4, scale))
    with pytest.raises(ValueError, match="read-only"):
        getattr(command, part)[2] = np.inf


@pytest.mark.parametrize("wrong", ["duty", None, 1, WheelMode, "arm"])
def test_mode_of_another_type_is_refused_with_those_that_there_are(wrong):
    wheel = ArmMode.DUTY if wrong == "arm" else wrong
    with pytest.raises(ValueError, match=r"wheel_mode: .*WheelMode\.DUTY, WheelMode\.EFFORT"):
        Command(np.zeros(4), wheel_mode=wheel)
    arm = WheelMode.DUTY if wrong == "arm" else wrong
    with pytest.raises(ValueError, match=r"arm_mode: .*ArmMode\.RATE, ArmMode\.POSITION"):
        Command(np.zeros(4), arm_mode=arm)


@pytest.mark.parametrize(
    "wrong", ["1234", [None] * 4, [object()] * 4, np.ones((2, 2)), [[1], [2, 3]]]
)
def test_what_is_no_row_of_numbers_is_refused_by_name(wrong):
    with pytest.raises(ValueError, match="command arm: "):
        Command(np.zeros(4), wrong)


def test_unknown_robot_is_named_with_what_there_is():
    with pytest.raises(ValueError, match="ghost/front_left.*rover1/front_left"):
        make(names=("ghost",))


@pytest.mark.parametrize("step", [0.0095, 0.1])
def test_servo_period_must_be_a_multiple_of_the_physics_step(step):
    model = compile_scene()
    model.opt.timestep = step
    with pytest.raises(ValueError, match="no multiple"):
        Simulation(model, ["rover1"])


def test_absent_sensor_reads_missing_not_zero():
    spec = mujoco.MjSpec.from_string(scene_xml())
    for sensor in list(spec.sensors):
        if sensor.name in ("rover1/gyro", "rover1/orientation"):
            spec.delete(sensor)
    seen = make(model=spec.compile()).robots["rover1"].observe()
    for name in ("gyro", "inclinometer", "heading", "stereo"):
        channel = getattr(seen, name)
        assert channel.validity is Validity.MISSING and channel.value.size == 0
    assert seen.accelerometer.validity is Validity.MEASURED
