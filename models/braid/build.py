"""BRAID in MJCF: stages of three bistable legs, closed loops, muscle wires (Thesis appendix E).

A platform hangs in its stage's base by three slides and a ball joint, free in itself. Each leg
turns about a hinge at the platform's rim and slides along itself; a ``connect`` holds its lower
end on the base disc, as the spherical joint does. A tendon along each leg has a stiffness that is a
polynomial with two wells, so the detent is native. Each leg has two bundles of muscle wires, one to
extend and one to retract it: MuJoCo's exact filter is the wire's temperature, its force is clamped
to be one-way.

Elements of stage k and leg j, both from 1: bodies ``stage{k}`` (its platform),
``stage{k}_leg{j}``; joints ``stage{k}_x_joint``, ``_y_``, ``_z_``, ``stage{k}_ball_joint``,
``stage{k}_leg{j}_hinge_joint``, ``stage{k}_leg{j}_joint`` (the slide, 0 in the middle, positive
longer); actuators ``stage{k}_leg{j}_extend`` and ``_retract``; sensor ``stage{k}_leg{j}_pos``.
Sites ``braid_base`` and ``stage{k}`` are the frames of `controllers.braid.arm.stage`.
"""

import dataclasses
import math

import mujoco
import numpy as np

from models.compose import build_scene, load_part
from models.configuration import FieldConfig, RobotPlacement
from models.datasheets import BRAID, CAMERA, MUSCLE_WIRE

LEGS = 3
BEARINGS = (-90.0, 30.0, 150.0)
"""Bearings of the legs about a disc's axis [deg]."""
TIMESTEP = 5e-4
"""Step of all scenes with BRAID [s]."""
MAX_STAGES = 20
BENCH = "braid/"
"""Prefix of all names on the bench."""
_VISUAL = {"contype": 0, "conaffinity": 0, "group": 2}
_DISC, _DISC_LAST = [0.86, 0.87, 0.84, 1.0], [0.80, 0.62, 0.25, 1.0]
_SLEEVE, _ROD = [0.30, 0.44, 0.72, 1.0], [0.75, 0.76, 0.78, 1.0]
_STIFF = {"solref": [10.0 * TIMESTEP, 1.0], "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0]}


@dataclasses.dataclass(frozen=True)
class BraidConfig:
    """A BRAID.

    Attributes:
        stages: Number of stages.
        head: Whether the last platform carries the stereo head.
        flexures: Whether the legs' hinges are as stiff as their flexures.
    """

    stages: int = 5
    head: bool = True
    flexures: bool = True

    def __post_init__(self) -> None:
        """Refuse what cannot be built.

        Raises:
            ValueError: If there is no stage, or too many.
        """
        if not 1 <= self.stages <= MAX_STAGES:
            raise ValueError(f"stages {self.stages}: expected 1 to {MAX_STAGES}")


def make_braid(config: BraidConfig) -> mujoco.MjSpec:
    """Return the mechanism, all its legs in the middle, ready to be attached.

    Args:
        config: Configuration of BRAID.
    """
    spec = mujoco.MjSpec()
    spec.modelname, spec.default.name = "braid", "braid_main"
    body = spec.worldbody.add_body(name="braid")
    body.add_site(name="braid_base", group=4)
    _add_disc(body, "braid_disc", _DISC)
    for stage in range(1, config.stages + 1):
        body = _add_stage(spec, body, stage, config)
    body.add_site(name="tip", group=4)
    # The head's origin is between the optical centres, in the housings' front faces: so its centre
    # of gravity is above the disc's middle, and its housings 4 mm above the disc.
    above = 0.5 * BRAID.disc_thickness + 0.0195
    body.add_site(name="stereo_mount", group=4, pos=[0.0, 0.5 * CAMERA.housing[2], above])
    return spec


def build_bench(config: BraidConfig, gravity: bool = True) -> mujoco.MjSpec:
    """Return BRAID alone on a table; in the key frame ``home`` all legs are short.

    All its names have ``braid/`` in front.

    Args:
        config: Configuration of BRAID.
        gravity: Whether there is gravity.
    """
    scene = load_part("field")
    scene.modelname, scene.default.name = "braid_bench", "main"
    for geom in list(scene.geoms):
        scene.delete(geom)
    scene.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1],
        pos=[0.0, 0.0, -0.05], rgba=[0.45, 0.47, 0.50, 1.0],
    )  # fmt: skip
    _set_options(scene)
    if not gravity:
        scene.option.gravity = [0.0, 0.0, 0.0]
    scene.worldbody.add_site(name="table", group=4)
    _attach(scene, config, "table", BENCH)
    return scene


def build_rover(
    config: BraidConfig, field: FieldConfig, placement: RobotPlacement
) -> mujoco.MjSpec:
    """Return a scene where a rover carries BRAID in place of its arm.

    Args:
        config: Configuration of BRAID.
        field: The field.
        placement: The rover; its name is in front of all names of BRAID.

    Raises:
        ValueError: As `build_scene`.
    """
    rover = dataclasses.replace(placement, arm=False, payload=None)
    scene = build_scene(field, [rover])
    prefix = f"{rover.name}/"
    _set_options(scene)
    for key in list(scene.keys):
        scene.delete(key)
    _attach(scene, config, f"{prefix}attachment_site", prefix)
    return scene


def _attach(scene: mujoco.MjSpec, config: BraidConfig, site: str, prefix: str) -> None:
    """Mount BRAID on a site, and make the key frame ``home``."""
    scene.attach(make_braid(config), site=scene.site(site), prefix=prefix)
    if config.head:
        mount = scene.site(f"{prefix}stereo_mount")
        scene.attach(load_part("stereo_head"), site=mount, prefix=prefix)
    model = scene.compile()
    data = mujoco.MjData(model)
    for stage in range(1, config.stages + 1):
        data.joint(f"{prefix}stage{stage}_z_joint").qpos = -BRAID.half_stroke
        for leg in range(1, LEGS + 1):
            data.joint(f"{prefix}stage{stage}_leg{leg}_joint").qpos = -BRAID.half_stroke
    scene.add_key(name="home", qpos=data.qpos.copy(), ctrl=data.ctrl.copy())


def _set_options(scene: mujoco.MjSpec) -> None:
    option = scene.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE


def _add_stage(
    spec: mujoco.MjSpec, base: mujoco.MjsBody, stage: int, config: BraidConfig
) -> mujoco.MjsBody:
    """Add a platform and its legs above a base disc, and return the platform's body."""
    name = f"stage{stage}"
    platform = base.add_body(name=name, pos=[0.0, 0.0, BRAID.middle])
    for index, axis in enumerate("xyz"):
        platform.add_joint(
            name=f"{name}_{axis}_joint",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[float(index == other) for other in range(3)],
        )
    platform.add_joint(name=f"{name}_ball_joint", type=mujoco.mjtJoint.mjJNT_BALL)
    platform.add_site(name=name, group=4)
    _add_disc(platform, f"{name}_disc", _DISC_LAST if stage == config.stages else _DISC)
    for leg, bearing in enumerate(np.radians(BEARINGS), start=1):
        radial = np.array([math.cos(bearing), math.sin(bearing), 0.0])
        base.add_site(name=f"{name}_foot{leg}", group=4, pos=BRAID.radius * radial)
        _add_leg(platform, f"{name}_leg{leg}", radial, config.flexures)
        spec.add_equality(
            name=f"{name}_foot{leg}",
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{name}_foot{leg}",
            name2=f"{name}_leg{leg}_end",
            **_STIFF,
        )
        _add_detent(spec, f"{name}_leg{leg}", f"{name}_foot{leg}")
        _add_wires(spec, f"{name}_leg{leg}")
    return platform


def _add_leg(platform: mujoco.MjsBody, name: str, radial: np.ndarray, flexures: bool) -> None:
    """Add a sleeve that turns about the rim's tangent, and a rod that slides in it."""
    sleeve = platform.add_body(name=name, pos=BRAID.radius * radial)
    sleeve.add_site(name=f"{name}_top", group=4)
    hinge = sleeve.add_joint(
        name=f"{name}_hinge_joint",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[-radial[1], radial[0], 0.0],
    )
    if flexures:
        hinge.stiffness = [BRAID.flexure_stiffness, 0.0, 0.0]
    _add_tube(
        sleeve,
        name,
        BRAID.sleeve_radius,
        -0.1 * BRAID.short,
        -0.75 * BRAID.short,
        BRAID.sleeve_mass,
        _SLEEVE,
    )
    rod = sleeve.add_body(name=f"{name}_rod", pos=[0.0, 0.0, -BRAID.middle])
    rod.add_joint(name=f"{name}_joint", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, -1.0])
    _add_tube(rod, f"{name}_rod", BRAID.rod_radius, 0.0, 0.75 * BRAID.short, BRAID.rod_mass, _ROD)
    rod.add_site(name=f"{name}_end", group=4)


def _add_detent(spec: mujoco.MjSpec, leg: str, foot: str) -> None:
    """Span a tendon along a leg that is a spring with two wells, and a damper."""
    tendon = spec.add_tendon(name=leg, group=4)
    tendon.wrap_site(foot)
    tendon.wrap_site(f"{leg}_top")
    tendon.springlength = [BRAID.middle, BRAID.middle]
    tendon.stiffness = [-BRAID.detent, 0.0, BRAID.detent / BRAID.half_stroke**2]
    tendon.damping = [BRAID.damping, 0.0, 0.0]


def _add_wires(spec: mujoco.MjSpec, leg: str) -> None:
    """Add both bundles of a leg: controls and states are temperatures above ambient [K]."""
    wire = MUSCLE_WIRE
    start, finish = (temperature - wire.ambient for temperature in wire.austenite)
    strength = BRAID.strands * wire.force
    slope = strength / (finish - start)
    slack = strength / (2.0 * BRAID.half_stroke)
    for end, sign, slackless in (("extend", 1.0, BRAID.short), ("retract", -1.0, -BRAID.long)):
        spec.add_actuator(
            name=f"{leg}_{end}",
            trntype=mujoco.mjtTrn.mjTRN_TENDON,
            target=leg,
            gear=[sign, 0.0, 0.0, 0.0, 0.0, 0.0],
            dyntype=mujoco.mjtDyn.mjDYN_FILTEREXACT,
            dynprm=[wire.time_constant, *[0.0] * 9],
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            gainprm=[slope, *[0.0] * 9],
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=[-slope * start + slack * slackless, -slack, *[0.0] * 8],
            ctrllimited=True,
            ctrlrange=[0.0, wire.heating],
            forcelimited=True,
            forcerange=[0.0, strength],
        )
    spec.add_sensor(
        name=f"{leg}_pos",
        type=mujoco.mjtSensor.mjSENS_JOINTPOS,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        objname=f"{leg}_joint",
    )


def _add_disc(body: mujoco.MjsBody, name: str, colour: list[float]) -> None:
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[BRAID.radius + BRAID.rim, 0.5 * BRAID.disc_thickness, 0.0],
        density=BRAID.density,
        rgba=colour,
        **_VISUAL,
    )


def _add_tube(
    body: mujoco.MjsBody, name: str, radius: float, top: float, bottom: float, mass: float,
    colour: list[float],
) -> None:  # fmt: skip
    """Add a capsule along z between two heights [m]."""
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.0, 0.0, top, 0.0, 0.0, bottom],
        size=[radius, 0.0, 0.0],
        mass=mass,
        rgba=colour,
        **_VISUAL,
    )
