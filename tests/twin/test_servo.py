import mujoco
import numpy as np
import pytest

from models.compose import FLAT, RobotPlacement, make_model
from models.datasheets import ARM, ARM_MOTOR, WHEEL_MOTOR
from tests.models.scenes import shaft_torque
from twin.connect import connect
from twin.describe import describe_rover
from twin.description import MotorDescription
from twin.realism import Realism
from twin.robot import (
    ArmMode,
    Channel,
    Command,
    Observation,
    RobotError,
    Validity,
    WheelMode,
    applied_command,
)
from twin.sensors import IDEAL
from twin.servo import Servo, ServoConfig

PERIOD = 0.01

ROVER_SERVO = ServoConfig.of(describe_rover())


def measured(values):
    return Channel(np.asarray(values, dtype=float), 0.0, Validity.MEASURED)


def observation(wheels=0.0, angles=0.0, rates=0.0):
    return Observation(
        0.0,
        wheel_speeds=measured(np.full(4, wheels)),
        arm_angles=measured(np.full(4, angles)),
        arm_rates=measured(np.full(4, rates)),
    )


def test_effort_inverts_the_motor_line():
    servo = Servo(ROVER_SERVO, PERIOD)
    command = Command(np.full(4, 1.0), np.full(4, -2.0), WheelMode.EFFORT, ArmMode.EFFORT)
    duty = servo.duty(command, observation(wheels=2.0, rates=-1.0))
    friction = (WHEEL_MOTOR.friction, ARM_MOTOR.friction)
    assert shaft_torque(WHEEL_MOTOR, duty[0], 2.0) == pytest.approx(1.0 - friction[0])
    assert shaft_torque(ARM_MOTOR, -duty[4], 1.0) == pytest.approx(2.0 - friction[1])


def test_line_agrees_with_the_compiled_motors():
    model = make_model_with_one_rover()
    data = mujoco.MjData(model)
    index = model.actuator("rover1/front_left").id
    joint = model.joint("rover1/front_left_joint")
    data.qvel[joint.dofadr[0]] = 2.0
    duty = Servo(ROVER_SERVO, PERIOD).duty(
        Command(np.full(4, 1.3), wheel_mode=WheelMode.EFFORT), observation(wheels=2.0)
    )
    data.ctrl[index] = 12.0 * duty[0]
    mujoco.mj_forward(model, data)
    assert data.actuator_force[index] == pytest.approx(1.3, rel=1e-4)


def make_model_with_one_rover():
    return make_model(FLAT, (RobotPlacement(),))


def test_out_of_range_is_clamped():
    servo = Servo(ROVER_SERVO, PERIOD)
    duty = servo.duty(Command(np.array([9.0, -9.0, 0.5, 0.0])), observation())
    np.testing.assert_array_equal(duty[:4], [1.0, -1.0, 0.5, 0.0])


@pytest.mark.parametrize("time_constant", [0.001, 0.02, 0.2])
def test_speed_loop_settles_without_offset_at_any_motor_inertia(time_constant):
    servo = Servo(ROVER_SERVO, PERIOD)
    no_load = ROVER_SERVO.wheels[0].no_load_speed
    command = Command(np.full(4, 2.0), wheel_mode=WheelMode.SPEED)
    speed, load = 0.0, 0.1
    follow = 1.0 - np.exp(-PERIOD / time_constant)
    speeds = []
    for _ in range(300):
        duty = servo.duty(command, observation(wheels=speed))[0]
        speed += follow * (no_load * (duty - load) - speed)
        speeds.append(speed)
    assert max(speeds) < 2.0 * 1.4
    assert speeds[-1] == pytest.approx(2.0, abs=1e-3)


def test_saturated_loop_does_not_wind_up():
    servo = Servo(ROVER_SERVO, PERIOD)
    command = Command(np.full(4, 6.9), wheel_mode=WheelMode.SPEED)
    for _ in range(500):
        servo.duty(command, observation(wheels=0.0))
    duty = servo.duty(command, observation(wheels=6.9))
    assert duty[0] < 1.2 * 6.9 / ROVER_SERVO.wheels[0].no_load_speed


@pytest.mark.parametrize("validity", [Validity.STALE, Validity.MISSING])
@pytest.mark.parametrize(
    "command, channel",
    [
        (Command(wheel_mode=WheelMode.SPEED), "wheel_speeds"),
        (Command(wheel_mode=WheelMode.EFFORT), "wheel_speeds"),
        (Command(arm_mode=ArmMode.RATE), "arm_rates"),
        (Command(arm_mode=ArmMode.POSITION), "arm_angles"),
    ],
)
def test_servo_does_not_drive_blind(command, channel, validity):
    blind = observation()._replace(**{channel: Channel(np.zeros(4), 0.0, validity)})
    with pytest.raises(RobotError, match=f"{channel}, which is {validity.value}"):
        Servo(ROVER_SERVO, PERIOD).duty(command, blind)


def test_duty_mode_needs_no_sensor():
    duty = Servo(ROVER_SERVO, PERIOD).duty(Command(np.full(4, 0.1)), Observation(0.0))
    np.testing.assert_array_equal(duty, [0.1] * 4 + [0.0] * 4)


def test_motors_get_the_duty_times_what_full_duty_is():
    volts, motors = np.linspace(5.0, 12.0, 8), np.zeros(8)
    servo = Servo(ROVER_SERVO, PERIOD, volts, motors)
    wheels, arm = servo.drive(Command(np.full(4, 0.5), np.full(4, -2.0)), Observation(0.0))
    np.testing.assert_array_equal(wheels, np.full(4, 0.5))
    np.testing.assert_array_equal(arm, np.full(4, -1.0))
    np.testing.assert_array_equal(motors, volts * np.repeat([0.5, -1.0], 4))


def test_duties_are_read_only_and_outlive_later_ones():
    servo, asked = Servo(ROVER_SERVO, PERIOD), np.linspace(-1.0, 1.0, 200)
    kept = [servo.drive(Command(np.full(4, duty)), Observation(0.0))[0] for duty in asked]
    np.testing.assert_array_equal(kept, np.tile(asked, (4, 1)).T)
    with pytest.raises(ValueError, match="read-only"):
        kept[0][0] = 1.0


def test_duty_that_is_no_number_leaves_the_motors_without_voltage():
    servo = Servo(ROVER_SERVO, PERIOD)
    servo.drive(Command(np.full(4, 0.5)), Observation(0.0))
    command = applied_command(np.array([0.0, np.nan, 0.0, 0.0]), np.zeros(4))
    with pytest.raises(ValueError, match="nan.*nothing was sent"):
        servo.drive(command, Observation(0.0))
    np.testing.assert_array_equal(servo.motors, np.zeros(8))


def test_motors_that_cannot_turn_are_refused():
    for numbers, name in (((1.0, 0.0), "no_load_speed"), ((np.nan, 1.0), "stall_torque")):
        with pytest.raises(ValueError, match=name):
            MotorDescription(*numbers)


def test_arm_of_the_rover_follows_a_sine_with_feed_forward():
    with connect("sim", realism=Realism(IDEAL)) as link:
        robot = link.robots["rover1"]
        robot.activate()
        home, errors = np.array(ARM.home), []
        for tick in range(400):
            time = tick * PERIOD
            target = home + 0.2 * np.sin(3.0 * time) + [0.0, 0.3, 0.3, 0.0]
            rates = np.full(4, 0.6 * np.cos(3.0 * time))
            seen = robot.observe()
            if time > 2.0:
                errors.append(seen.arm_angles.value - target)
            robot.command(Command(arm=target, arm_mode=ArmMode.POSITION, arm_rates=rates))
            link.clock.tick()
    assert np.sqrt(np.mean(np.square(errors))) < 0.015
