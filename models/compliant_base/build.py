"""Compile the simplified plant of chapter 2 for any parameter set and arm mode."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping

import mujoco
import numpy as np

XML = pathlib.Path(__file__).with_name("compliant_base.xml")
_DOFS = ("x", "y", "z", "pitch", "roll", "yaw")


def compile_plant(
    parameters: Mapping[str, float], axis: np.ndarray, rotation: np.ndarray
) -> mujoco.MjModel:
    """Return the plant with a base of the given parameters and the arm held in one mode.

    Args:
        parameters: The 22 values by name (`datasheets.TABLE_2_1_TRUTH` has them all), SI units;
            inertia entries are elements of the tensor about the base's centre of gravity.
        axis: (3,) unit axis of the arm's joint in the base frame.
        rotation: (3, 3) of the arm in the base frame at angle zero.

    Returns:
        A compiled model: RK4 at 0.5 ms, ctrl[0] the arm's jerk [rad/s^3].
    """
    p = dict(parameters)
    spec = mujoco.MjSpec.from_file(str(XML))
    base, arm = spec.body("base"), spec.body("arm")
    base.mass = p["mass"]
    base.fullinertia = [p["ixx"], p["iyy"], p["izz"], p["ixy"], p["ixz"], p["iyz"]]
    for dof in _DOFS:
        joint = spec.joint(f"{dof}_joint")
        suffix = dof if len(dof) == 1 else f"_{dof}"
        joint.stiffness = [p[f"k{suffix}"], 0, 0]
        joint.damping = [p[f"b{suffix}"], 0, 0]
    arm.pos = [p["rx"], p["ry"], p["rz"]]
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, dtype=float).ravel())
    arm.quat = quaternion
    spec.joint("arm_joint").axis = rotation.T @ axis
    return spec.compile()
