"""A field on a slope: gravity that is turned, and the frame that is level all the same."""

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from models.configuration import FieldConfig, RobotPlacement
from perception.geometry.gravity import GRAVITY

LEVEL = "level"
"""Site at the origin of a field on a slope: its z axis points against gravity."""


def turn_to_level(field: FieldConfig) -> Rotation:
    """Return the rotation from the field's axes to level ones, z up.

    The level y axis lies below or above the field's, so that headings are counted from it as they
    are on level ground. The field's pitch and roll are those of a robot that looks along its y.

    Args:
        field: Gives the slope.
    """
    right, forward = np.sin(field.slope)
    return Rotation.from_euler(
        "XY", [np.arcsin(forward), -np.arcsin(right / np.sqrt(1.0 - forward**2))]
    )


def incline(scene: mujoco.MjSpec, field: FieldConfig, robots: Sequence[RobotPlacement]) -> None:
    """Turn gravity, and refer the robots' sensors of orientation to the level frame.

    What senses specific force tilts with gravity by itself; a sensor of the orientation would read
    the tilt to the slope instead, and the azimuth in it.

    Args:
        scene: Scene with the robots.
        field: Gives the slope; a level one leaves the scene as it is.
        robots: Robots of the scene.
    """
    if not any(field.slope):
        return
    scene.option.gravity = -GRAVITY * field.up
    level = turn_to_level(field).inv().as_quat(scalar_first=True)
    scene.worldbody.add_site(name=LEVEL, quat=level, group=4)
    for robot in robots:
        sensor = scene.sensor(f"{robot.name}/orientation")
        if sensor is not None:
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_SITE, LEVEL
