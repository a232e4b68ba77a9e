"""A small scene with the names of the real rovers, quick to compile."""

import mujoco

from twin.description import MotorDescription
from twin.robot import ARM_JOINTS, WHEELS
from twin.servo import ServoConfig

STALL, NO_LOAD = 6.0, 6.5
SERVO = ServoConfig(*[(MotorDescription(STALL, NO_LOAD),) * 4] * 2)


def _arm(prefix: str) -> str:
    axes = ("0 0 1", "1 0 0", "1 0 0", "1 0 0")
    text = ""
    for joint, axis in zip(ARM_JOINTS, axes):
        text += (
            f'<body name="{prefix}{joint}" pos="0 0.03 0.03">'
            f'<joint name="{prefix}{joint}_joint" axis="{axis}" range="-2 2" armature="0.01"/>'
            '<geom type="capsule" fromto="0 0 0 0 0.1 0" size="0.01" mass="0.1"/>'
        )
        if joint == "base_yaw":
            text += f'<site name="{prefix}arm_base"/>'
    return text + "</body>" * 4


def _rover(prefix: str, x: float) -> str:
    wheels = ""
    for wheel in WHEELS:
        px = -0.14 if wheel.endswith("left") else 0.14
        py = 0.15 if wheel.startswith("front") else -0.15
        wheels += (
            f'<body name="{prefix}{wheel}" pos="{px} {py} 0">'
            f'<joint name="{prefix}{wheel}_joint" axis="-1 0 0" armature="0.01"/>'
            '<geom type="cylinder" size="0.05 0.02" zaxis="1 0 0" mass="0.2"/></body>'
        )
    rear = (
        f'<body name="{prefix}rear_chassis" pos="0 -0.1 0">'
        f'<joint name="{prefix}centre_joint" axis="0 1 0" range="-.5 .5" damping="1"/>'
        '<geom type="box" size="0.08 0.05 0.02" mass="1" contype="0" conaffinity="0"/></body>'
    )
    cameras = "".join(
        f'<camera name="{prefix}stereo_{side}" pos="{px} 0.2 0.3" xyaxes="1 0 0 0 0.7 0.7" '
        'focal="0.0085 0.0085" sensorsize="0.0064 0.0048" resolution="102 98"/>'
        for side, px in (("left", -0.019), ("right", 0.019))
    )
    return (
        f'<body name="{prefix}chassis" pos="{x} 0 0.06"><freejoint name="{prefix}root_joint"/>'
        f'<site name="{prefix}imu"/>'
        '<geom type="box" size="0.08 0.1 0.02" mass="2" contype="0" conaffinity="0"/>'
        f"{wheels}{rear}{_arm(prefix)}{cameras}</body>"
    )


def _motors(prefix: str) -> str:
    axes = (*WHEELS, *ARM_JOINTS)
    gain, bias = STALL / 12.0, -STALL / NO_LOAD
    return "".join(
        f'<general name="{prefix}{axis}" joint="{prefix}{axis}_joint" ctrllimited="true" '
        f'ctrlrange="-12 12" biastype="affine" gainprm="{gain}" biasprm="0 0 {bias}"/>'
        for axis in axes
    )


def _sensors(prefix: str) -> str:
    text = "".join(
        f'<jointvel name="{prefix}{axis}_vel" joint="{prefix}{axis}_joint"/>'
        for axis in (*WHEELS, *ARM_JOINTS)
    )
    text += "".join(
        f'<jointpos name="{prefix}{axis}_pos" joint="{prefix}{axis}_joint"/>'
        for axis in (*ARM_JOINTS, "centre")
    )
    text += f'<force name="{prefix}arm_base_force" site="{prefix}arm_base"/>'
    text += f'<torque name="{prefix}arm_base_torque" site="{prefix}arm_base"/>'
    text += f'<accelerometer name="{prefix}accelerometer" site="{prefix}imu"/>'
    text += f'<gyro name="{prefix}gyro" site="{prefix}imu"/>'
    text += f'<accelerometer name="{prefix}inclinometer" site="{prefix}imu" nsample="10"/>'
    return text + (
        f'<framequat name="{prefix}orientation" objtype="body" objname="{prefix}chassis"/>'
    )


def scene_xml(names: tuple[str, ...] = ("rover1",)) -> str:
    """MJCF of rovers side by side on a plane."""
    prefixes = [f"{name}/" for name in names]
    bodies = "".join(_rover(prefix, 1.0 * i) for i, prefix in enumerate(prefixes))
    return (
        '<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>'
        '<asset><texture name="noise" type="2d" builtin="flat" mark="random" random="0.3" '
        'rgb1="0.2 0.2 0.2" markrgb="0.9 0.9 0.9" width="256" height="256"/>'
        '<material name="ground" texture="noise" texrepeat="4 4" texuniform="true"/></asset>'
        '<worldbody><light pos="0 0 3"/>'
        '<geom name="ground" type="plane" size="5 5 0.1" material="ground"/>'
        f"{bodies}</worldbody><actuator>{''.join(map(_motors, prefixes))}</actuator>"
        f"<sensor>{''.join(map(_sensors, prefixes))}</sensor></mujoco>"
    )


def compile_scene(names: tuple[str, ...] = ("rover1",)) -> mujoco.MjModel:
    """The compiled scene."""
    return mujoco.MjModel.from_xml_string(scene_xml(names))
