"""Masses, motors and suspension of the compiled rover."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from scipy.optimize import curve_fit

from models import datasheets
from models.compose import (
    ARM_JOINTS,
    FLAT,
    FOLDER,
    ROUGH,
    WHEELS,
    PayloadConfig,
    RobotPlacement,
    make_model,
)
from models.datasheets import ARM, ROVER, TABLE_2_2_TRUTH, WHEEL_MOTOR
from tests.models.scenes import PLAIN, Scene, make_scene, tilt

GRAVITY = 9.81
ARM_BODIES = ("arm_base_link", "turret", "upper_arm", "forearm", "wrist", "stereo_head")


def drive(data: mujoco.MjData, left: float, right: float) -> None:
    """Set the wheel voltages of both sides [V]."""
    for wheel in WHEELS:
        data.actuator(f"rover1/{wheel}").ctrl = left if "left" in wheel else right


def wheel_speeds(data: mujoco.MjData) -> np.ndarray:
    return np.array([data.sensor(f"rover1/{wheel}_vel").data[0] for wheel in WHEELS])


def test_rover_without_arm_weighs_3_74_kg_and_arm_0_76_kg(rover, bare):
    arm = sum(rover.model.body(f"rover1/{name}").mass[0] for name in ARM_BODIES)
    assert bare.model.body_mass.sum() == pytest.approx(3.74, abs=1e-9)
    assert arm == pytest.approx(0.76, abs=1e-9)
    assert rover.model.body_mass.sum() == pytest.approx(3.74 + 0.76, abs=1e-9)


def test_robot_without_stereo_weighs_the_same(rover):
    blind = make_model(PLAIN, [RobotPlacement(stereo=False)])
    assert blind.ncam == 0
    assert blind.body_mass.sum() == pytest.approx(rover.model.body_mass.sum())


def test_every_inertia_is_positive_obeys_the_triangle_inequality_and_fits_its_body():
    model = make_model(PLAIN, [RobotPlacement(payload=PayloadConfig(0.2))])
    for body in range(1, model.nbody):
        small, middle, large = np.sort(model.body_inertia[body])
        name = model.body(body).name
        assert small > 0.0, name
        assert small + middle >= large * (1.0 - 1e-9), name
        gyration = math.sqrt(large / model.body_mass[body])
        assert 0.005 < gyration < 0.15, f"{name}: radius of gyration {gyration} m"


def test_centre_of_gravity_lies_at_the_chassis_origin_and_the_mount_where_table_2_2_has_it():
    model = mujoco.MjModel.from_xml_path(str(FOLDER / "rover" / "rover.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    origin = data.body("chassis").xpos
    np.testing.assert_allclose(data.subtree_com[0], origin, atol=1e-6)
    mount = data.site("attachment_site").xpos - origin
    expected = [TABLE_2_2_TRUTH["ry"], TABLE_2_2_TRUTH["rz"]]
    np.testing.assert_allclose(mount[1:], expected, atol=1e-6)


@pytest.fixture(scope="module")
def lifted() -> Scene:
    """One rover without gravity, wheels in the air."""
    model = make_model(PLAIN, [RobotPlacement(arm=False)])
    model.opt.gravity[:] = 0.0
    model.geom_contype[:] = 0
    return Scene(model, mujoco.MjData(model))


@pytest.mark.parametrize("wheel", WHEELS)
def test_wheel_turns_at_49_rpm_under_208_oz_in(lifted, wheel):
    assert steady_speed(lifted, wheel, datasheets.WHEEL_RATED_TORQUE) == pytest.approx(
        49.0, rel=2e-3
    )


def test_wheel_turns_at_63_56_rpm_without_load(lifted):
    assert steady_speed(lifted, "rear_left", 0.0) == pytest.approx(63.56, rel=2e-3)


def steady_speed(scene: Scene, wheel: str, load: float) -> float:
    """Return the speed [rpm] at which a wheel at 12 V settles against a braking torque [N m]."""
    data = scene.start()
    dof = scene.model.joint(f"rover1/{wheel}_joint").dofadr[0]
    data.actuator(f"rover1/{wheel}").ctrl = 12.0
    data.qfrc_applied[dof] = -load
    scene.run(data, 1.0)
    return float(data.qvel[dof]) / datasheets.RPM


def test_wheel_starts_against_less_and_not_against_more_than_908_oz_in(lifted):
    stall = 908.0 * datasheets.OUNCE_INCH
    assert steady_speed(lifted, "front_right", 0.99 * stall) > 0.3
    assert abs(steady_speed(lifted, "front_right", stall)) < 0.01


def test_rover_drives_at_25_cm_a_second_under_208_oz_in(rover):
    data = rover.start()
    drive(data, 12.0, 12.0)
    for wheel in WHEELS:
        dof = rover.model.joint(f"rover1/{wheel}_joint").dofadr[0]
        data.qfrc_applied[dof] = -datasheets.WHEEL_RATED_TORQUE
    rover.run(data, 1.0)
    before = data.body("rover1/chassis").xpos.copy()
    rover.run(data, 2.0)
    velocity = (data.body("rover1/chassis").xpos - before) / 2.0
    assert velocity[1] == pytest.approx(0.25, rel=0.01)
    assert abs(velocity[0]) < 1e-3


@pytest.mark.parametrize("axis", ["along", "across"])
def test_rover_at_0_volt_does_not_creep_on_a_slope_of_10_degrees(axis):
    scene = make_scene(RobotPlacement())
    slope = math.radians(10.0)
    scene.model.opt.gravity[:] = [0.0, 0.0, -GRAVITY * math.cos(slope)]
    scene.model.opt.gravity["across along".split().index(axis)] = -GRAVITY * math.sin(slope)
    data = scene.start()
    for wheel in WHEELS:
        assert data.actuator(f"rover1/{wheel}").ctrl[0] == 0.0
    scene.run(data, 1.0)
    before = data.body("rover1/chassis").xpos.copy()
    scene.run(data, 2.0)
    creep = np.linalg.norm(data.body("rover1/chassis").xpos - before) / 2.0
    assert creep < 2e-5  # 0.02 mm/s: the softness of MuJoCo's friction


def test_arm_holds_its_home_pose_under_the_holding_voltages(rover):
    data = rover.run(rover.start(), 5.0)
    angles = [data.joint(f"rover1/{name}_joint").qpos[0] for name in ARM_JOINTS]
    np.testing.assert_allclose(angles, ARM.home, atol=0.01)


def test_force_sensor_reads_the_weight_of_the_arm_upward(rover):
    force = rover.rest.sensor("rover1/arm_base_force").data
    np.testing.assert_allclose(np.linalg.norm(force), 0.76 * GRAVITY, rtol=1e-3)
    assert force[2] > 0.99 * 0.76 * GRAVITY


def test_payload_adds_its_weight_to_what_the_force_sensor_reads(rover):
    loaded = make_scene(RobotPlacement(payload=PayloadConfig(0.15, (0.0, 0.02, 0.0))))
    force = loaded.rest.sensor("rover1/arm_base_force").data
    np.testing.assert_allclose(np.linalg.norm(force), 0.91 * GRAVITY, rtol=1e-3)


@pytest.mark.parametrize("joint", ARM_JOINTS[1:])
def test_arm_lies_along_y_at_zero_angles_and_positive_lifts(rover, joint):
    data = rover.start()
    for name in ARM_JOINTS:
        data.joint(f"rover1/{name}_joint").qpos = 0.0
    mujoco.mj_kinematics(rover.model, data)
    tip, base = data.site("rover1/gripper").xpos, data.site("rover1/arm_base").xpos
    reach = ARM.upper_length + ARM.forearm_length + ARM.wrist_length
    np.testing.assert_allclose((tip - base)[1], reach, atol=2e-3)
    before = tip[2]
    data.joint(f"rover1/{joint}_joint").qpos = 0.1
    mujoco.mj_kinematics(rover.model, data)
    assert data.site("rover1/gripper").xpos[2] > before


def test_arm_can_swing_half_a_radian_at_10_rad_a_second(rover):
    """The motors' torque at speed covers gravity and inertia of the stretched arm."""
    data = rover.start()
    dof = rover.model.joint("rover1/shoulder_joint").dofadr[0]
    for name in ARM_JOINTS:
        data.joint(f"rover1/{name}_joint").qpos = 0.0
    worst = 0.0
    for phase in np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False):
        data.joint("rover1/shoulder_joint").qpos = 0.5 + 0.5 * math.sin(phase)
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        speed = data.qvel[dof] = 5.0 * math.cos(phase)
        data.qacc[dof] = -50.0 * math.sin(phase)
        mujoco.mj_inverse(rover.model, data)
        torque = data.qfrc_inverse[dof]
        limit = datasheets.ARM_MOTOR.gross_stall_torque * (
            1.0 - math.copysign(speed, torque * speed) / datasheets.ARM_MOTOR.gross_no_load_speed
        )
        worst = max(worst, abs(torque) / limit)
    assert worst < 0.9


def series_stiffness(model: mujoco.MjModel, tyre: float) -> tuple[float, float]:
    """Return heave [N/m] and pitch [N m/rad] stiffness after Thesis eq. A-1.

    Each wheel's spring and tyre act in series; the pitch sum is over K l_y^2, as small angles make
    of the arc tangent, and has no horizontal part because the body turns about the ground line.
    """
    heave = pitch = 0.0
    for wheel in WHEELS:
        joint = model.joint(f"rover1/{wheel}_suspension_joint").id
        spring = model.jnt_stiffness[joint].flat[0]
        single = 1.0 / (1.0 / spring + 1.0 / tyre)
        heave += single
        pitch += single * model.body(f"rover1/{wheel}_wheel").pos[1] ** 2
    return heave, pitch


def measured_tyre_stiffness(scene: Scene) -> float:
    """Return a tyre's stiffness from its penetration under 20 N more load [N/m]."""
    data, load = scene.start(), 20.0
    before = min(contact.dist for contact in data.contact)
    for body in range(1, scene.model.nbody):
        if scene.model.body(body).name.endswith("_wheel"):
            data.xfrc_applied[body, 2] = -load
    scene.run(data, 1.0)
    return load / (before - min(contact.dist for contact in data.contact))


def push(scene: Scene, force: float = 0.0, couple: float = 0.0) -> tuple[float, float]:
    """Return rise [m] and pitch [rad] under a steady vertical force [N] and pitch couple [N m]."""
    data = scene.start()
    body = scene.model.body("rover1/chassis").id
    data.xfrc_applied[body] = [0.0, 0.0, force, couple, 0.0, 0.0]
    scene.run(data, 2.0)
    rise = data.body(body).xpos[2] - scene.rest.body(body).xpos[2]
    turn = tilt(data, "rover1/chassis")[0] - tilt(scene.rest, "rover1/chassis")[0]
    return float(rise), float(turn)


def test_static_stiffness_equals_the_series_springs_of_a_1(bare):
    heave, pitch = series_stiffness(bare.model, measured_tyre_stiffness(bare))
    assert -10.0 / push(bare, force=-10.0)[0] == pytest.approx(heave, rel=0.05)
    assert 3.0 / push(bare, couple=3.0)[1] == pytest.approx(pitch, rel=0.05)


@pytest.mark.parametrize("couple", [1.0, 3.0, -3.0])
def test_pitch_stiffness_is_table_2_2s_317_newton_metres_a_radian(bare, couple):
    stiffness = couple / push(bare, couple=couple)[1]
    assert stiffness == pytest.approx(TABLE_2_2_TRUTH["k_pitch"], rel=2e-3)


def test_pitch_inertia_about_the_ground_line_is_table_2_2s_0_072(bare):
    """Kinetic energy of the body turning about the tyres' contact line at one radian a second."""
    model, data = bare.model, bare.start()
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    velocity = np.zeros(model.nv)
    velocity[3] = 1.0
    velocity[1] = -data.body("rover1/chassis").xpos[2]
    for wheel in WHEELS:
        slide = model.joint(f"rover1/{wheel}_suspension_joint").dofadr[0]
        velocity[slide] = -model.body(f"rover1/{wheel}_wheel").pos[1]
    inertia = velocity @ mass @ velocity
    assert inertia == pytest.approx(TABLE_2_2_TRUTH["ixx"], rel=1e-3)


def test_free_pitch_decays_with_the_inertia_and_damping_of_table_2_2(bare):
    data, body = bare.start(), bare.model.body("rover1/chassis").id
    data.xfrc_applied[body, 3] = 0.5
    bare.run(data, 1.0)
    data.xfrc_applied[:] = 0.0
    times = np.arange(1, 601) * bare.model.opt.timestep
    angles = []
    for _ in times:
        mujoco.mj_step(bare.model, data)
        angles.append(tilt(data, "rover1/chassis")[0])

    def wave(t, size, decay, rate, phase, offset):
        return size * np.exp(-decay * t) * np.cos(rate * t + phase) + offset

    start = [angles[0], 10.0, 66.0, 0.0, 0.0]
    _, decay, rate, _, _ = curve_fit(wave, times, np.array(angles), start)[0]
    inertia = TABLE_2_2_TRUTH["k_pitch"] / (rate**2 + decay**2)
    assert inertia == pytest.approx(TABLE_2_2_TRUTH["ixx"], rel=0.02)
    assert 2.0 * decay * inertia == pytest.approx(TABLE_2_2_TRUTH["b_pitch"], rel=0.03)


@pytest.mark.parametrize(("left", "right"), [(-4.0, 4.0), (0.0, 8.0), (4.0, 8.0), (-8.0, 8.0)])
def test_skid_steering_turns_at_half_to_two_thirds_of_the_kinematic_rate(
    rover, left, right, record_property
):
    """The wheels scrub, so that the rover turns slower than (v_right - v_left) / track."""
    data = rover.start()
    drive(data, left, right)
    rover.run(data, 1.5)
    speeds, rates = [], []
    for _ in range(1500):
        mujoco.mj_step(rover.model, data)
        speeds.append(wheel_speeds(data))
        rates.append(data.sensor("rover1/gyro").data[2])
    mean = np.mean(speeds, axis=0)
    difference = mean[[1, 3]].mean() - mean[[0, 2]].mean()
    kinematic = difference * ROVER.wheel_radius / (2.0 * ROVER.half_track)
    ratio = float(np.mean(rates)) / kinematic
    record_property("turn_rate_over_kinematic", float(ratio))
    assert kinematic > 0.0
    assert 0.5 < ratio < 0.67


def contact_fraction(locked: bool, seed: int, seconds: float) -> float:
    """Return the share of the time with all four tyres on the ground, at 8 to 10 cm/s."""
    field = dataclasses.replace(ROUGH, seed=seed, texture_pixels=16)
    robot = RobotPlacement(position=(0.0, -1.2), centre_locked=locked)
    scene = make_scene(robot, field=field)
    data = scene.start()
    tyres = [scene.model.geom(f"rover1/{wheel}_tyre").id for wheel in WHEELS]
    drive(data, 2.4, 2.4)
    steps = round(seconds / scene.model.opt.timestep)
    touching = 0
    for _ in range(steps):
        mujoco.mj_step(scene.model, data)
        touching += np.isin(tyres, data.contact.geom).all()
    moved = data.body("rover1/chassis").xpos[1] + 1.2
    assert moved > 0.03 * seconds, "the rover is stuck"
    return touching / steps


@pytest.mark.slow
def test_free_centre_keeps_four_wheels_down_on_rough_ground_and_a_locked_one_does_not(
    record_property,
):
    seeds = range(3)
    free = np.array([contact_fraction(False, seed, 12.0) for seed in seeds])
    locked = np.array([contact_fraction(True, seed, 12.0) for seed in seeds])
    record_property("free", free.tolist())
    record_property("locked", locked.tolist())
    assert free.mean() >= 0.95
    assert locked.mean() < 0.60
    assert np.all(locked < free)


@pytest.mark.parametrize("name", ["flat", "rough"])
def test_scene_driven_with_noise_for_a_second_gives_no_warning(name):
    field = {"flat": FLAT, "rough": ROUGH}[name]
    robots = [
        RobotPlacement("rover1"),
        RobotPlacement("rover2", (1.0, 0.5), 0.7, payload=PayloadConfig(0.1)),
        RobotPlacement("rover3", (-1.0, 0.5), -2.0, stereo=False, centre_locked=True),
    ]
    scene = make_scene(*robots, field=field)
    data, rng = scene.start(), np.random.default_rng(0)
    for _ in range(100):
        data.ctrl[:] = rng.uniform(-12.0, 12.0, scene.model.nu)
        scene.run(data, 0.01)
    assert np.all(np.isfinite(data.qpos))


def test_motor_at_0_volt_brakes_by_its_back_emf(lifted):
    data = lifted.start()
    dof = lifted.model.joint("rover1/front_left_joint").dofadr[0]
    data.qvel[dof] = 3.0
    mujoco.mj_forward(lifted.model, data)
    torque = -WHEEL_MOTOR.gross_stall_torque * 3.0 / WHEEL_MOTOR.gross_no_load_speed
    assert data.actuator("rover1/front_left").force[0] == pytest.approx(torque, rel=1e-5)
