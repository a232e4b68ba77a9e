"""Compile the simplified plant of chapter 2 for any parameter set and arm mode."""

import pathlib
from collections.abc import Mapping

import mujoco
import numpy as np

XML = pathlib.Path(__file__).with_name("compliant_base.xml")
_DOFS = ("x", "y", "z", "pitch", "roll", "yaw")


def compile_plant(
    parameters: Mapping[str, float],
    axis: np.ndarray,
    rotation: np.ndarray,
    hinges_outermost: bool = False,
) -> mujoco.MjModel:
    """Return the plant with a base of the given parameters and the arm held in one mode.

    Args:
        parameters: The 22 values by name (`datasheets.TABLE_2_1_TRUTH` has them all), SI units;
            inertia entries are elements of the tensor about the base's centre of gravity.
        axis: (3,) unit axis of the arm's joint in the base frame.
        rotation: (3, 3) of the arm in the base frame at angle zero.
        hinges_outermost: Put the hinges before the slides, as Thesis appendix B.2 does: the base
            then turns about the springs' nominal position.

    Returns:
        A compiled model: RK4 at 0.5 ms, ctrl[0] the arm's jerk [rad/s^3].
    """
    spec = hold_arm(axis, rotation)
    set_parameters(spec, parameters)
    if hinges_outermost:
        _move_slides_inwards(spec)
    return spec.compile()


def hold_arm(axis: np.ndarray, rotation: np.ndarray) -> mujoco.MjSpec:
    """Return the plant with Table 2-1's values and the arm held as in `compile_plant`."""
    spec = mujoco.MjSpec.from_file(str(XML))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, dtype=float).ravel())
    spec.body("arm").quat = quaternion
    spec.joint("arm_joint").axis = rotation.T @ axis
    return spec


def _move_slides_inwards(spec: mujoco.MjSpec) -> None:
    base = spec.body("base")
    slides = [joint for joint in base.joints if joint.type == mujoco.mjtJoint.mjJNT_SLIDE]
    kept = [(j.name, *(np.array(v) for v in (j.axis, j.stiffness, j.damping))) for j in slides]
    for joint in slides:
        spec.delete(joint)
    for name, axis, stiffness, damping in kept:
        joint = base.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        joint.stiffness, joint.damping = stiffness, damping


def set_parameters(spec: mujoco.MjSpec, parameters: Mapping[str, float]) -> None:
    """Give the plant the 22 values by name, SI units."""
    p = dict(parameters)
    base = spec.body("base")
    base.mass = p["mass"]
    base.fullinertia = [p["ixx"], p["iyy"], p["izz"], p["ixy"], p["ixz"], p["iyz"]]
    for dof in _DOFS:
        joint = spec.joint(f"{dof}_joint")
        suffix = dof if len(dof) == 1 else f"_{dof}"
        joint.stiffness = [p[f"k{suffix}"], 0, 0]
        joint.damping = [p[f"b{suffix}"], 0, 0]
    spec.body("arm").pos = [p["rx"], p["ry"], p["rz"]]
