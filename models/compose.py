"""Put robots and a field together into one scene, by MuJoCo's native attachment.

Each robot's names get its own name and a slash in front: ``rover1/chassis``, ``rover1/shoulder``.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from models import clutter, datasheets, terrain
from models.as_made import AsMade, alter_arm, alter_head, alter_rover
from models.card_and_slot.stand import hold_card, stand_slot
from models.configuration import (
    FLAT,
    LABORATORY,
    ROUGH,
    START_RADIUS,
    FieldConfig,
    PayloadConfig,
    RobotPlacement,
    check_panel,
    check_robots,
    check_screens,
)
from models.ground_friction import FrictionMap, TyreFriction, draw_friction, keep_friction
from models.materials import add_materials, draw_sun
from models.mjcf import read_spec
from models.slope import incline

__all__ = [
    "ARM_JOINTS",
    "AsMade",
    "FLAT",
    "FOLDER",
    "LABORATORY",
    "ROUGH",
    "FieldConfig",
    "OwnRobot",
    "PayloadConfig",
    "RobotPlacement",
    "TEXTURE_TILE",
    "WHEELS",
    "add_home",
    "arm_hold_voltage",
    "build_scene",
    "compile_scene",
    "load_part",
    "load_robot",
    "make_model",
    "make_terrain",
    "settle",
]

FOLDER = Path(__file__).parent
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
ARM_JOINTS = ("base_yaw", "shoulder", "elbow", "wrist")
TEXTURE_TILE = FieldConfig.texture_tile
"""Edge of the ground's noise tile, unless the field says another [m]."""
_ROCK_FACETS = 16, 10
"""Slices and stacks in which rocks and what else is round is drawn among rocks. In MuJoCo's 28 and
16 a pair that shows 240 of them took 218 ms of software OpenGL; in these it takes 158 ms, and grey
levels change by 0.9 r.m.s., less than the cameras' noise."""
_FRICTION_STEPS = 10  # Physics steps for which a tyre that settles keeps its friction.


def load_part(name: str) -> mujoco.MjSpec:
    """Read one part, ``<name>/<name>.xml``, without its key frames.

    Args:
        name: Folder of the part below ``models``.

    Returns:
        The part, ready to be attached.

    Raises:
        ValueError: If there is no such part or its MJCF cannot be read.
    """
    path = FOLDER / name / f"{name}.xml"
    if not path.is_file():
        known = sorted(p.parent.name for p in FOLDER.glob("*/*.xml") if p.stem == p.parent.name)
        raise ValueError(f"no model part {name!r}; there are {', '.join(known)}")
    try:
        spec = read_spec(path)
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"model part {name!r} is not valid MJCF ({path}): {reason}") from error
    for key in list(spec.keys):
        spec.delete(key)
    spec.default.name = f"{name}_main"  # unique, so that the scene's XML can be read back
    return spec


@dataclasses.dataclass(frozen=True)
class OwnRobot:
    """A robot that a user brings.

    Attributes:
        spec: MJCF of the robot without key frames, ready to be attached.
        angles: Position of each hinge and slide at rest, by joint name [rad or m].
        controls: Control of each actuator that holds it there, by name.
        half_size: Half of its extent along x and y [m].
    """

    spec: mujoco.MjSpec
    angles: Mapping[str, float]
    controls: Mapping[str, float]
    half_size: tuple[float, float]


def load_robot(path: str) -> OwnRobot:
    """Read a robot's MJCF file, as `RobotPlacement.model` names it.

    Args:
        path: The file.

    Raises:
        ValueError: If it cannot be read or compiled, it or what it names is too large, or it has no
            free body ``chassis``.
    """
    try:
        spec = read_spec(path)
        model = spec.compile()
    except (OSError, ValueError, RuntimeError) as error:
        raise ValueError(f"robot model {path}: {' '.join(str(error).split())}") from error
    chassis = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "chassis")
    if chassis < 0 or model.body_dofnum[chassis] != 6:  # noqa: PLR2004
        raise ValueError(f"robot model {path}: there is no free body 'chassis'")
    data = mujoco.MjData(model)
    home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if home >= 0:
        mujoco.mj_resetDataKeyframe(model, data, home)
    mujoco.mj_kinematics(model, data)
    reach = np.abs(data.geom_xpos - data.xpos[chassis])[:, :2] + model.geom_rbound[:, None]
    x, y = reach[model.geom_contype > 0].max(axis=0, initial=0.0).tolist()
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    single = [i for i in range(model.njnt) if model.jnt_type[i] in (slide, hinge)]
    for key in list(spec.keys):
        spec.delete(key)
    spec.default.name = f"{Path(path).stem}_main"
    return OwnRobot(
        spec,
        {model.joint(i).name: float(data.qpos[model.jnt_qposadr[i]]) for i in single},
        {model.actuator(i).name: float(data.ctrl[i]) for i in range(model.nu)},
        (x, y),
    )


def make_terrain(field: FieldConfig, robots: Sequence[RobotPlacement] = ()) -> terrain.Terrain:
    """Return the ground that `build_scene` makes of the same arguments.

    Args:
        field: The field.
        robots: Robots whose starts are kept free of rocks and blocks.

    Returns:
        Heights, rocks, blocks, screens and friction, in the world frame; the panel is not among
        them.
    """
    height_seed, rock_seed, _, block_seed = np.random.SeedSequence(field.seed).spawn(4)
    heights = terrain.make_heights(
        np.random.default_rng(height_seed), field.size, field.relief, field.cell
    )
    bare = terrain.Terrain(field.size, heights)
    discs = [*field.clear, *((*robot.position, START_RADIUS) for robot in robots)]
    if field.panel is not None:
        discs.append((*field.panel.position, field.panel.footprint))
    clear = np.array(discs).reshape(-1, 3)
    clear = np.concatenate([clear, *(screen.discs for screen in field.screens)])
    blocks = clutter.make_blocks(
        np.random.default_rng(block_seed),
        field.size,
        bare.ground_at,
        field.blocks,
        field.block_edge,
        clear,
    )
    clear = np.concatenate([clear, np.column_stack([blocks.centres[:, :2], blocks.radii])])
    rocks = terrain.make_rocks(
        np.random.default_rng(rock_seed),
        bare,
        field.rocks,
        field.rock_radius,
        clear,
    )
    screens = clutter.make_screens(field.screens, bare.ground_at)
    return dataclasses.replace(
        bare, rocks=rocks, blocks=blocks, screens=screens, friction=_draw_friction(field)
    )


def _draw_friction(field: FieldConfig) -> FrictionMap | None:
    if field.friction is not None:
        return FrictionMap(field.size, np.full((1, 1), field.friction))
    if field.friction_patches is None:
        return None
    # The fifth stream is the sun's.
    rng = np.random.default_rng(np.random.SeedSequence(field.seed).spawn(6)[5])
    return draw_friction(rng, field.size, field.friction_patches, field.friction_patch)


def build_scene(field: FieldConfig, robots: Sequence[RobotPlacement]) -> mujoco.MjSpec:
    """Compose a scene; it may be added to before it is compiled.

    The key frame ``home`` holds every robot a hair above the ground with its arm folded, and the
    voltages that carry the arm's weight there. Add it again with `add_home` after changing the
    number of joints or actuators.

    Args:
        field: The field.
        robots: The robots, with different names.

    Returns:
        The scene.

    Raises:
        ValueError: If two robots share a name, one starts outside the field or at the panel, or a
            screen stands at one, at the panel or over the edge.
    """
    check_robots(field, robots)
    check_panel(field, robots)
    check_screens(field, robots)
    ground = make_terrain(field, robots)
    scene = load_part("field")
    scene.modelname = "scene"
    scene.default.name = "main"
    add_materials(scene, field)
    draw_sun(scene, field)
    _add_ground(scene, ground)
    clutter.add_solids(scene, "rock", mujoco.mjtGeom.mjGEOM_ELLIPSOID, ground.rocks)
    if len(ground.rocks.centres):
        scene.visual.quality.numslices, scene.visual.quality.numstacks = _ROCK_FACETS
    clutter.add_solids(scene, "block", mujoco.mjtGeom.mjGEOM_BOX, ground.blocks)
    clutter.add_solids(scene, "screen", mujoco.mjtGeom.mjGEOM_BOX, ground.screens, "block")
    if field.panel is not None:
        clutter.add_panel(
            scene, field.panel, float(ground.ground_at(np.array(field.panel.position)))
        )
    for robot in robots:
        _add_robot(scene, robot, _start_height(ground, robot), field.friction)
        if robot.card:
            hold_card(scene, robot.name, gives=field.card_guides)
    if field.slot_width is not None:
        height = float(ground.ground_at(np.zeros(2)))
        stand_slot(scene, field.slot_width, height, guides=field.card_guides)
    if not field.shadows:
        for light in scene.lights:
            light.castshadow = False
    incline(scene, field, robots)
    if field.friction_patches is not None and ground.friction is not None:
        keep_friction(scene, ground.friction)
    if robots:
        add_home(scene, robots)
    return scene


def compile_scene(scene: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a scene.

    Args:
        scene: Scene from `build_scene`.

    Returns:
        The model.

    Raises:
        ValueError: If MuJoCo refuses it; the message names the element.
    """
    try:
        return scene.compile()
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"the scene does not compile: {error}") from error


def make_model(field: FieldConfig, robots: Sequence[RobotPlacement]) -> mujoco.MjModel:
    """Compose and compile a scene; see `build_scene`."""
    return compile_scene(build_scene(field, robots))


def settle(model: mujoco.MjModel, seconds: float = 2.0) -> mujoco.MjData:
    """Let the robots of a scene come to rest from ``home``.

    Args:
        model: Compiled model of a scene; friction in patches is given to its tyres.
        seconds: Time to wait [s].

    Returns:
        Data at rest, time set back to zero, with the arms' holding voltages as controls.
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    steps = max(1, round(seconds / model.opt.timestep))
    tyres = TyreFriction.of(model)
    if tyres is None:
        mujoco.mj_step(model, data, steps)
    else:
        for begin in range(0, steps, _FRICTION_STEPS):
            tyres.update(data)
            mujoco.mj_step(model, data, min(_FRICTION_STEPS, steps - begin))
        tyres.update(data)
    _shift_history(model, data, -data.time)
    data.time = 0.0
    mujoco.mj_forward(model, data)
    return data


def _shift_history(model: mujoco.MjModel, data: mujoco.MjData, shift: float) -> None:
    """Move the stamps of kept sensor samples; ones from the future would block new samples."""
    for (count, _), start in zip(model.sensor_history, model.sensor_historyadr):
        if count > 0:
            # Two words of book-keeping, then the stamps.
            data.history[start + 2 : start + 2 + count] += shift


def arm_hold_voltage(model: mujoco.MjModel, data: mujoco.MjData, robot: str) -> NDArray[np.float64]:
    """Return the voltages that carry an arm against gravity where it is now.

    Args:
        model: Compiled model of a scene.
        data: After ``mj_forward``, with the arm at rest.
        robot: Name of the robot.

    Returns:
        (4,) [V], in the order of `ARM_JOINTS`.
    """
    motor = datasheets.ARM_MOTOR
    dofs = [model.joint(f"{robot}/{name}_joint").dofadr[0] for name in ARM_JOINTS]
    return data.qfrc_bias[dofs] / motor.gross_stall_torque * motor.voltage


def add_home(scene: mujoco.MjSpec, robots: Sequence[RobotPlacement]) -> None:
    """Give a scene the key frame ``home``, in place of an older one.

    Args:
        scene: Scene from `build_scene`.
        robots: The robots that it was built with.
    """
    for key in list(scene.keys):
        if key.name == "home":
            scene.delete(key)
    model = compile_scene(scene)
    data = mujoco.MjData(model)
    armed = [robot for robot in robots if robot.arm and not robot.model]
    for robot in robots:
        if robot.model:
            own = load_robot(robot.model)
            for name, angle in own.angles.items():
                data.joint(f"{robot.name}/{name}").qpos = angle
            for name, control in own.controls.items():
                data.actuator(f"{robot.name}/{name}").ctrl = control
    for robot in armed:
        for name, angle in zip(ARM_JOINTS, datasheets.ARM.home, strict=True):
            data.joint(f"{robot.name}/{name}_joint").qpos = angle
    mujoco.mj_forward(model, data)
    for robot in armed:
        voltages = arm_hold_voltage(model, data, robot.name)
        for name, voltage in zip(ARM_JOINTS, voltages, strict=True):
            data.actuator(f"{robot.name}/{name}").ctrl = voltage
    scene.add_key(name="home", qpos=data.qpos.copy(), ctrl=data.ctrl.copy())


def _add_ground(scene: mujoco.MjSpec, ground: terrain.Terrain) -> None:
    if ground.is_flat:
        scene.worldbody.add_geom(
            name="ground",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[ground.size[0] / 2.0, ground.size[1] / 2.0, 0.1],
            material="ground",
        )
        return
    low, high = ground.heights.min(), ground.heights.max()
    rows, columns = ground.heights.shape
    scene.add_hfield(
        name="ground",
        nrow=rows,
        ncol=columns,
        size=[ground.size[0] / 2.0, ground.size[1] / 2.0, high - low, 0.1],
        userdata=((ground.heights - low) / (high - low)).ravel(),
    )
    scene.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="ground",
        pos=[0.0, 0.0, low],
        material="ground",
    )


def _start_height(ground: terrain.Terrain, robot: RobotPlacement) -> float:
    """Height that leaves every wheel a tenth of a millimetre above what is below the rover."""
    sheet = datasheets.ROVER
    half = sheet.half_track + sheet.wheel_half_width, sheet.half_wheelbase + sheet.wheel_radius
    if robot.model:
        half = load_robot(robot.model).half_size
    side = np.linspace(-1.0, 1.0, 21)
    x, y = half[0] * side, half[1] * side
    corners = np.stack(np.meshgrid(x, y), axis=-1)
    c, s = math.cos(robot.yaw), math.sin(robot.yaw)
    points = corners @ np.array([[c, s], [-s, c]]) + robot.position
    return float(np.max(ground.height_at(points))) + 1e-4


def _add_robot(
    scene: mujoco.MjSpec, robot: RobotPlacement, height: float, friction: float | None
) -> None:
    prefix = f"{robot.name}/"
    frame = scene.worldbody.add_frame(
        pos=[*robot.position, height], quat=clutter.yaw_quaternion(robot.yaw)
    )
    if robot.model:
        scene.attach(load_robot(robot.model).spec, frame=frame, prefix=prefix)
        return
    rover = load_part("rover")
    if robot.made is not None:
        alter_rover(rover, robot.made)
    if friction is not None:
        for wheel in WHEELS:
            rover.geom(f"{wheel}_tyre").friction[0] = friction
    scene.attach(rover, frame=frame, prefix=prefix)
    if robot.patterned:
        for end in ("front", "rear"):
            scene.geom(f"{prefix}{end}_deck").material = "block"
    if robot.centre_locked:
        scene.add_equality(
            name=f"{prefix}centre_lock",
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=f"{prefix}centre_joint",
            solref=[0.004, 1.0],
        )
    if robot.arm:
        _add_arm(scene, robot, prefix)


def _add_arm(scene: mujoco.MjSpec, robot: RobotPlacement, prefix: str) -> None:
    arm, head = load_part("arm"), load_part("stereo_head")
    if robot.made is not None:
        alter_arm(arm, robot.made)
        alter_head(head, robot.made)
    scene.attach(arm, site=scene.site(f"{prefix}attachment_site"), prefix=prefix)
    if not robot.stereo:
        for camera in list(head.cameras):
            head.delete(camera)
    mount = scene.site(f"{prefix}stereo_mount")
    mount.pos = np.asarray(mount.pos) + [0.0, 0.0, robot.mast]
    scene.attach(head, site=mount, prefix=prefix)
    if robot.payload is None:
        return
    load = robot.payload
    centre = np.asarray(scene.site(f"{prefix}gripper").pos) + load.centre
    body = scene.body(f"{prefix}wrist").add_body(name=f"{prefix}payload", pos=centre)
    body.add_geom(
        name=f"{prefix}payload",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=load.half_size,
        mass=load.mass,
        rgba=[0.75, 0.25, 0.2, 1.0],
    )
