"""A truss stage, the segment that goes into it, and two rovers that hold the segment by its ends.

Thesis section A.4, figure A-9. All happens in the vertical plane of the world's y and z: the
master looks along y, the slave against it, and the segment goes down between two nodes. The thesis
prints no dimension of it.

Segment frame: world axes when it hangs level; origin in the middle of the web's lower edge, which
is the leading edge. Stage frame: origin in the middle of the mouth.
"""

import dataclasses
import math
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from models import datasheets
from models.compose import (
    ARM_JOINTS,
    FieldConfig,
    RobotPlacement,
    arm_hold_voltage,
    build_scene,
    compile_scene,
)
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

MASTER, SLAVE = "rover1", "rover2"
_BOX = mujoco.mjtGeom.mjGEOM_BOX
_SEGMENT_BIT, _ALL_BITS = 2, 3
"""The segment meets the stage alone: its grips are welds, and it never reaches the ground."""


@dataclasses.dataclass(frozen=True)
class TrussSheet:
    """Segment and stage; lengths [m]. All are assumptions but the clearance."""

    web_width: float = 0.16  # Assumption: fits between the rovers
    web_height: float = 0.05  # Assumption: keeps the chord and the grippers clear of the nodes
    thickness: float = 0.012  # Assumption
    grip_span: float = 0.30  # Between the grips. Assumption: rovers stand clear of the stage
    chord_half: float = 0.01  # Assumption: a square tube of 20 mm
    mass: float = 0.30  # Assumption: an arm carries its half at full reach [kg]
    clearance: float = 0.03  # Of the web's width: the narrowest slot of Thesis Table 5-1
    depth: float = 0.03  # Where the segment is seated. Assumption
    wall: float = 0.03  # Width of a node's face. Assumption
    friction: float = 0.3  # Assumption: as card and slot
    reach: float = 0.40  # Of the grip ahead of a rover's centre. Assumption: mid workspace
    seated_height: float = 0.20  # Of the chord above the ground. Assumption: mid workspace
    grip_pitch: float = -0.5  # Of the gripper's axis [rad]. Assumption: the palm clears the chord

    @property
    def mouth(self) -> float:
        """Width between the nodes [m]."""
        return self.web_width * (1.0 + self.clearance)

    @property
    def grip_rise(self) -> float:
        """Height of the grips above the leading edge [m]."""
        return self.web_height + self.chord_half

    @property
    def mouth_height(self) -> float:
        """Height of the mouth above the ground [m]."""
        return self.seated_height - self.grip_rise + self.depth


TRUSS: Final = TrussSheet()


def placements() -> list[RobotPlacement]:
    """Return the two rovers, face to face."""
    stand = TRUSS.grip_span / 2.0 + TRUSS.reach
    return [
        RobotPlacement(MASTER, (0.0, -stand), centre_locked=True),
        RobotPlacement(SLAVE, (0.0, stand), math.pi, centre_locked=True),
    ]


def make_truss(height: float, angles: ArrayLike, offset: float, tilt: float) -> mujoco.MjModel:
    """Compile the scene.

    Args:
        height: Height of the chord above the ground at the start [m].
        angles: (4,) joints of both arms there, as the grips have it [rad].
        offset: Offset of the stage along y from its place [m].
        tilt: Tilt of the stage about x [rad].

    Returns:
        A model with the bodies ``segment`` and ``stage``, the welds ``grip_rover1`` and
        ``grip_rover2`` (first the gripper, then the segment) and the key frame ``start``.

    Raises:
        ValueError: If a number is not finite, or there are not four angles.
    """
    pose = np.asarray(angles, dtype=float)
    numbers = [height, offset, tilt, *pose.ravel()]
    if pose.shape != (4,) or not np.all(np.isfinite(numbers)):
        raise ValueError(
            f"truss at {height} m, angles {angles}, offset {offset} m, tilt {tilt} rad: expected "
            "finite numbers and four angles"
        )
    scene = build_scene(FieldConfig(texture_pixels=16), placements())
    _add_stage(scene, offset, tilt)
    _add_segment(scene, height)
    for key in list(scene.keys):
        scene.delete(key)
    model = compile_scene(scene)
    data = mujoco.MjData(model)
    _start(model, data, pose)
    scene.add_key(name="start", qpos=data.qpos.copy(), ctrl=data.ctrl.copy())
    return compile_scene(scene)


def settle_truss(model: mujoco.MjModel, seconds: float = 1.0) -> mujoco.MjData:
    """Let rovers and segment come to rest from ``start``.

    Args:
        model: Compiled model from `make_truss`.
        seconds: Time to wait [s].
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_step(model, data, max(1, round(seconds / model.opt.timestep)))
    state = mujoco.mjtState.mjSTATE_PHYSICS
    rest = np.empty(mujoco.mj_stateSize(model, state))
    mujoco.mj_getState(model, data, rest, state)
    # Fresh data has no sensor samples with stamps from the future.
    settled = mujoco.MjData(model)
    mujoco.mj_setState(model, settled, rest, state)
    settled.ctrl[:] = data.ctrl
    settled.time = 0.0
    mujoco.mj_forward(model, settled)
    return settled


def _add_stage(scene: mujoco.MjSpec, offset: float, tilt: float) -> None:
    """Add two nodes on posts, turned about the middle of the mouth."""
    sheet = TRUSS
    stage = scene.worldbody.add_body(
        name="stage",
        pos=[0.0, offset, sheet.mouth_height],
        quat=[math.cos(tilt / 2.0), math.sin(tilt / 2.0), 0.0, 0.0],
    )
    half = [2.0 * sheet.thickness, sheet.wall / 2.0, sheet.mouth_height / 2.0]
    for name, side in (("near", -1.0), ("far", 1.0)):
        stage.add_geom(
            name=f"stage_{name}",
            type=_BOX,
            size=half,
            pos=[0.0, side * (sheet.mouth / 2.0 + half[1]), -half[2]],
            rgba=[0.35, 0.38, 0.42, 1.0],
            contype=_ALL_BITS,
            conaffinity=_ALL_BITS,
            **_hard(),
        )


def _add_segment(scene: mujoco.MjSpec, height: float) -> None:
    """Add the segment, free, and weld its ends to the grippers."""
    sheet = TRUSS
    segment = scene.worldbody.add_body(name="segment", pos=[0.0, 0.0, height - sheet.grip_rise])
    segment.add_freejoint(name="segment_joint")
    web = [sheet.thickness / 2.0, sheet.web_width / 2.0, sheet.web_height / 2.0]
    chord = [sheet.chord_half, sheet.grip_span / 2.0, sheet.chord_half]
    volumes = np.array([math.prod(web), math.prod(chord)])
    masses = sheet.mass * volumes / volumes.sum()
    for name, size, rise, mass in (
        ("web", web, web[2], masses[0]),
        ("chord", chord, sheet.grip_rise, masses[1]),
    ):
        segment.add_geom(
            name=f"segment_{name}",
            type=_BOX,
            size=size,
            pos=[0.0, 0.0, rise],
            mass=float(mass),
            rgba=[0.80, 0.45, 0.15, 1.0],
            contype=_SEGMENT_BIT,
            conaffinity=_SEGMENT_BIT,
            **_hard(),
        )
    half = sheet.grip_pitch / 2.0
    pitched = [math.cos(half), math.sin(half), 0.0, 0.0]
    turned = [0.0, 0.0, math.sin(half), math.cos(half)]  # half a turn about z, then the pitch
    for robot, side, quaternion in ((MASTER, -1.0, pitched), (SLAVE, 1.0, turned)):
        place = [0.0, side * sheet.grip_span / 2.0, sheet.grip_rise]
        segment.add_site(name=f"segment_{robot}", pos=place, quat=quaternion, group=4)
        scene.add_equality(
            name=f"grip_{robot}",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{robot}/gripper",
            name2=f"segment_{robot}",
            solref=[0.01, 1.0],  # pads of rubber on the fingers
        )


def _hard() -> dict[str, list[float]]:
    """Contact as hard as a step of 1 ms allows."""
    return {"solref": [0.004, 1.0], "friction": [TRUSS.friction, 0.005, 1e-4]}


def _start(model: mujoco.MjModel, data: mujoco.MjData, angles: FloatArray) -> None:
    """Put both arms to the grips, with the voltages that hold them and half the segment each."""
    for robot in (MASTER, SLAVE):
        for name, angle in zip(ARM_JOINTS, angles, strict=True):
            data.joint(f"{robot}/{name}_joint").qpos = angle
    mujoco.mj_forward(model, data)
    motor = datasheets.ARM_MOTOR
    per_effort = motor.voltage / motor.gross_stall_torque
    jacobian = np.zeros((3, model.nv))
    for robot in (MASTER, SLAVE):
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(f"{robot}/gripper").id)
        dofs = [model.joint(f"{robot}/{name}_joint").dofadr[0] for name in ARM_JOINTS]
        share = jacobian[2, dofs] * TRUSS.mass * GRAVITY / 2.0
        voltages = arm_hold_voltage(model, data, robot) + share * per_effort
        for name, voltage in zip(ARM_JOINTS, voltages, strict=True):
            data.actuator(f"{robot}/{name}").ctrl = voltage
