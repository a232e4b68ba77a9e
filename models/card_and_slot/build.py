"""Build card and slot for any slot width, and a bench where a compliant hand holds the card."""

import math

import mujoco

from models.datasheets import CARD_AND_SLOT, HAND

PAINT = 3e-5
"""Half thickness of a marker [m]: a thick one shows its edge, from the side."""
_HIDDEN = {"contype": 0, "conaffinity": 0, "mass": 0.0}
CONTACT = {"solref": [0.004, 1.0], "friction": [CARD_AND_SLOT.friction, 0.005, 1e-4]}
"""Contact as hard as a step of 1 ms allows."""
_DISC = "marker_disc"
_RIM = 128
"""Corners of a marker's rim. MuJoCo draws its own cylinders with 28, which are 0.8 % smaller than
the circle: enough to tilt the pose of what carries the markers by a degree."""
_BOX, _MESH = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


def add_card(scene: mujoco.MjSpec, parent: mujoco.MjsBody, prefix: str = "") -> mujoco.MjsBody:
    """Add the body ``card`` in the parent's frame, with its wrench site and markers.

    Args:
        scene: Scene that it is attached to.
        parent: Body to add to; the card's frame is the parent's until it is moved.
        prefix: Prefix of the names ``card``, ``card_plate``, ``card_marker0`` and ``1`` and the
            site ``card_wrench``.

    Returns:
        The card's body.
    """
    sheet = CARD_AND_SLOT
    half = [sheet.card_width / 2.0, sheet.card_length / 2.0, sheet.card_thickness / 2.0]
    body = parent.add_body(name=f"{prefix}card")
    body.add_geom(
        name=f"{prefix}card_plate",
        type=_BOX,
        size=half,
        pos=[0.0, -half[1], 0.0],
        mass=8.0 * math.prod(half) * sheet.card_density,
        rgba=[0.10, 0.42, 0.22, 1.0],
        **CONTACT,
    )
    body.add_site(name=f"{prefix}card_wrench", size=[0.002] * 3, group=4)
    for index, (x, y) in enumerate(sheet.card_markers):
        add_marker(scene, body, f"{prefix}card_marker{index}", x, y, half[2])
    return body


def add_slot(
    scene: mujoco.MjSpec, parent: mujoco.MjsBody, width: float, prefix: str = ""
) -> mujoco.MjsBody:
    """Add the body ``slot`` in the parent's frame: two walls with a marker each.

    Args:
        scene: Scene that it is attached to.
        parent: Body to add to, for instance the world's; move the slot by its ``pos`` and
            ``quat``.
        width: Distance between the walls [m].
        prefix: Prefix of ``slot``, ``slot_left``, ``slot_right``, ``slot_marker0`` and ``1``.

    Returns:
        The slot's body.

    Raises:
        ValueError: If the width is not a positive length.
    """
    if not 0.0 < width < math.inf:
        raise ValueError(f"slot width {width} m: expected a positive length")
    sheet = CARD_AND_SLOT
    half = [sheet.wall / 2.0, sheet.slot_depth / 2.0, sheet.wall_height / 2.0]
    outward, inward = sheet.slot_marker_inset
    body = parent.add_body(name=f"{prefix}slot")
    for index, (name, side) in enumerate((("left", -1.0), ("right", 1.0))):
        body.add_geom(
            name=f"{prefix}slot_{name}",
            type=_BOX,
            size=half,
            pos=[side * (width / 2.0 + half[0]), half[1], 0.0],
            rgba=[0.20, 0.21, 0.25, 1.0],
            **CONTACT,
        )
        add_marker(
            scene,
            body,
            f"{prefix}slot_marker{index}",
            side * (width / 2.0 + outward),
            inward,
            half[2],
        )
    return body


def build_bench(width: float, friction: float = CARD_AND_SLOT.friction) -> mujoco.MjSpec:
    """Return the slot at the origin and the card on a compliant hand.

    The body ``hand`` has three slides and three hinges with `datasheets.HAND`'s springs, whose rest
    (``qpos_spring``) is where the hand is commanded: a moved carrier, as a mocap body would be, has
    no velocity in MuJoCo, and what it holds slides without friction. There is no gravity: the
    wrench sensor is tared. Sensors ``card_force`` and ``card_torque`` at the site ``card_wrench``,
    in the card's frame, read what the hand puts on the card; at rest that is the negative of what
    the slot puts on it.

    Args:
        width: Distance between the slot's walls [m].
        friction: Coefficient of friction between card and slot.

    Returns:
        A scene at 1 ms.

    Raises:
        ValueError: If the width is not a positive length or the friction is negative.
    """
    spec = bench_scene()
    add_slot(spec, spec.worldbody, width)
    add_card(spec, spec.body("hand"))
    complete_bench(spec, friction)
    return spec


def bench_scene() -> mujoco.MjSpec:
    """Return a scene with a compliant hand, for card and slot."""
    spec = mujoco.MjSpec()
    spec.modelname = "card_and_slot"
    spec.compiler.degree = False
    option = spec.option
    option.timestep, option.gravity = 1e-3, [0.0, 0.0, 0.0]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.80, 0.86, 0.92],
        rgb2=[0.35, 0.45, 0.55],
        width=64,
        height=64,
    )
    spec.worldbody.add_light(pos=[0.0, 0.0, 1.0], dir=[0.0, 0.0, -1.0])
    _add_hand(spec.worldbody)
    return spec


def complete_bench(bench: mujoco.MjSpec, friction: float) -> None:
    """Give card and slot their friction, and add sensors of what the hand puts on the card.

    Args:
        bench: Scene with hand, card and slot.
        friction: Coefficient of friction between card and slot.

    Raises:
        ValueError: If the friction is negative.
    """
    if not 0.0 <= friction < math.inf:
        raise ValueError(f"friction {friction}: expected 0 or more")
    for geom in bench.geoms:
        geom.friction[0] = friction
    for name, kind in (
        ("card_force", mujoco.mjtSensor.mjSENS_FORCE),
        ("card_torque", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        bench.add_sensor(
            name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="card_wrench"
        )


def _add_hand(parent: mujoco.MjsBody) -> mujoco.MjsBody:
    """Add the body ``hand`` on the springs of its six degrees of freedom."""
    # MuJoCo must have an inertia; the joints' armature, that of rotors, is a hundred times this.
    # `to_xml` leaves out an inertia whose place is not given.
    hand = parent.add_body(name="hand", mass=HAND.mass, inertia=[1e-4] * 3, ipos=[0.0] * 3)
    hand.explicitinertial = True
    for kind, turn in ((_SLIDE, False), (_HINGE, True)):
        for axis, letter in enumerate("xyz"):
            joint = hand.add_joint(
                name=f"hand_{'turn_' if turn else ''}{letter}_joint",
                type=kind,
                axis=[float(axis == other) for other in range(3)],
                armature=HAND.inertia if turn else 0.0,
            )
            joint.stiffness = [HAND.turn_stiffness if turn else HAND.stiffness, 0, 0]
            joint.damping = [HAND.turn_damping if turn else HAND.damping, 0, 0]
    return hand


def add_marker(
    scene: mujoco.MjSpec, body: mujoco.MjsBody, name: str, x: float, y: float, top: float
) -> None:
    """Add a round marker that touches nothing, on the face of a body at a height [m].

    Args:
        scene: Scene of the body.
        body: Body that carries the marker.
        name: Name of the marker.
        x: Place of its middle across [m].
        y: Place of its middle ahead [m].
        top: Height of the face above the body's middle [m].
    """
    if scene.mesh(_DISC) is None:
        disc = scene.add_mesh(name=_DISC, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        disc.scale = [CARD_AND_SLOT.marker_diameter / 2.0] * 2 + [PAINT]
        disc.make_cone(_RIM, 1.0)  # as wide at its top
    body.add_geom(
        name=name,
        type=_MESH,
        meshname=_DISC,
        pos=[x, y, top],
        rgba=[0.95, 0.95, 0.95, 1.0],
        **_HIDDEN,
    )
