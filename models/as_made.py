"""Robots as made: a rover and its arm, drawn anew from the drawing's tolerances by a seed.

The changes are made to the parts before they are attached, so that a scene's names and joints stay
those of the drawing. Only the play of the arm's gears adds joints: each motor's joint ``x_joint``,
with encoder, friction and rotor, is followed by ``x_play`` about the same axis in the same body.
"""

import dataclasses
from collections.abc import Collection, Sequence

import mujoco
import numpy as np

from models.datasheets import TOLERANCES, Tolerances
from perception.geometry.checks import check_numbers

PLAY_DAMPING = 0.01
"""Damping of a gear's play [N m s/rad]. Assumption: grease; it settles a joint without load."""
_PLAY_STOP = (0.002, 1.0)  # solref of the teeth: the hardest at a physics step of 1 ms
_ROVER, _ARM, _HEAD, _TYRES = range(4)  # Streams of random numbers, one for each part.
_BOX = (0.05, 0.05, 0.025)  # Half sizes of a payload [m].


@dataclasses.dataclass(frozen=True)
class Change:
    """What happened to a robot since it was made.

    Attributes:
        payload: Mass of a box on the rear deck [kg].
        payload_place: Centre of the box in the rover's frame, rightward and forward [m].
        springs: Stiffness of the wheels' springs over that when it was made.
        left_springs: Stiffness of those of the left wheels over that as well.
        worn_wheel: Name of a wheel with another tyre friction, such as ``rear_left``; empty for
            none.
        grip: That wheel's friction over that when it was made.
    """

    payload: float = 0.0
    payload_place: tuple[float, float] = (0.0, -0.11)
    springs: float = 1.0
    left_springs: float = 1.0
    worn_wheel: str = ""
    grip: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what cannot happen.

        Raises:
            ValueError: Naming the field.
        """
        check_numbers("change", self, "springs", "left_springs", "grip")
        check_numbers("change", self, "payload", zero=True)


UNCHANGED = Change()


@dataclasses.dataclass(frozen=True)
class AsMade:
    """Which robot was made from a drawing.

    Attributes:
        seed: Random seed of all that the drawing leaves open, not negative.
        tolerances: How far it may lie from the drawing.
        change: What happened to it since.
    """

    seed: int
    tolerances: Tolerances = TOLERANCES
    change: Change = UNCHANGED

    def __post_init__(self) -> None:
        """Refuse a seed that NumPy refuses.

        Raises:
            ValueError: If it is negative.
        """
        if self.seed < 0:
            raise ValueError(f"seed of a robot as made: got {self.seed}, needs 0 or more")

    def generator(self, part: int) -> np.random.Generator:
        """Return the random generator of a part, whose draws depend on no other part."""
        return np.random.default_rng([self.seed, part])


def alter_rover(rover: mujoco.MjSpec, made: AsMade) -> None:
    """Make a rover without its arm.

    Wheels stay balanced: their centre of gravity is on the axle.

    Args:
        rover: Part ``rover`` as drawn; changed in place.
        made: Tolerances and seed.
    """
    rng, tolerances = made.generator(_ROVER), made.tolerances
    wheels = [joint.parent for joint in rover.joints if joint.classname.name == "rover_wheel"]
    _alter_bodies(rover, tolerances, rng, {wheel.name for wheel in wheels})
    rover.site("attachment_site").pos += _shift(rng, tolerances.length)
    for wheel in wheels:
        wheel.pos += _shift(rng, tolerances.length)
        suspension, _ = wheel.joints
        suspension.stiffness[0] *= _factor(rng, tolerances.spring)
        suspension.damping[0] *= _factor(rng, tolerances.damper)
        larger = _factor(rng, tolerances.wheel_radius)
        tyre = _tyre(rover, wheel)
        tyre.size[1:] *= larger
        rover.geom(wheel.name).size[0] *= larger
    # At the start the lowest wheel touches the ground, as the drawing's four do.
    if tolerances.length or tolerances.wheel_radius:
        rover.body("chassis").pos[2] = max(_tyre(rover, w).size[1] - w.pos[2] for w in wheels)
    if tolerances.tyre_friction is not None:
        # The same rubber on the same ground: one coefficient for a robot.
        friction = made.generator(_TYRES).uniform(*tolerances.tyre_friction)
        for wheel in wheels:
            _tyre(rover, wheel).friction[0] = friction
    _change(rover, made.change, wheels)


def _change(rover: mujoco.MjSpec, change: Change, wheels: Sequence[mujoco.MjsBody]) -> None:
    """Change a rover that was made.

    Raises:
        ValueError: If it has no such wheel.
    """
    for wheel in wheels:
        left = change.left_springs if wheel.pos[0] < 0.0 else 1.0
        wheel.joints[0].stiffness[0] *= change.springs * left
    if change.worn_wheel:
        names = [wheel.name.removesuffix("_wheel") for wheel in wheels]
        if change.worn_wheel not in names:
            raise ValueError(f"no wheel {change.worn_wheel!r}; available: {', '.join(names)}")
        tyre = _tyre(rover, wheels[names.index(change.worn_wheel)])
        tyre.friction[0] *= change.grip
    if change.payload > 0.0:
        deck = rover.geom("rear_deck")
        top = deck.pos[2] + deck.size[2] + _BOX[2]
        box = rover.body("rear_chassis").add_body(name="payload", pos=[*change.payload_place, top])
        box.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=_BOX,
            mass=change.payload,
            contype=0,
            conaffinity=0,
            group=deck.group,
        )


def alter_arm(arm: mujoco.MjSpec, made: AsMade) -> None:
    """Make an arm: bodies, places of joints, friction and play of their gears.

    Args:
        arm: Part ``arm`` as drawn; changed in place.
        made: Tolerances and seed.
    """
    rng, tolerances = made.generator(_ARM), made.tolerances
    _alter_bodies(arm, tolerances, rng)
    for joint in list(arm.joints):
        joint.parent.pos += _shift(rng, tolerances.length)
        joint.frictionloss *= _factor(rng, tolerances.joint_friction)
        half = rng.uniform(*tolerances.backlash) / 2.0
        if half > 0.0:
            joint.parent.add_joint(
                name=joint.name.replace("_joint", "_play"),
                axis=joint.axis,
                range=[-half, half],
                solref_limit=_PLAY_STOP,
                damping=[PLAY_DAMPING, 0.0, 0.0],
                armature=0.0,
                frictionloss=0.0,
            )


def alter_head(head: mujoco.MjSpec, made: AsMade) -> None:
    """Make a stereo head's body; where its cameras are is a matter of their calibration.

    Args:
        head: Part ``stereo_head`` as drawn; changed in place.
        made: Tolerances and seed.
    """
    _alter_bodies(head, made.tolerances, made.generator(_HEAD))


def _alter_bodies(
    part: mujoco.MjSpec,
    tolerances: Tolerances,
    rng: np.random.Generator,
    balanced: Collection[str] = (),
) -> None:
    """Change masses and centres of gravity; radii of gyration stay, so inertias stay possible."""
    if not (tolerances.mass or tolerances.centre):
        return  # An inertia that is given again would round otherwise.
    drawn = part.compile()
    for body in part.bodies[1:]:
        weighed, factor = drawn.body(body.name), _factor(rng, tolerances.mass)
        shift = _shift(rng, tolerances.centre)
        body.explicitinertial = True
        body.mass = factor * weighed.mass[0]
        body.ipos = weighed.ipos + (0.0 if body.name in balanced else shift)
        body.iquat, body.inertia = weighed.iquat, factor * weighed.inertia


def _tyre(rover: mujoco.MjSpec, wheel: mujoco.MjsBody) -> mujoco.MjsGeom:
    return rover.geom(wheel.name.replace("_wheel", "_tyre"))


def _factor(rng: np.random.Generator, share: float) -> float:
    return float(rng.uniform(1.0 - share, 1.0 + share))


def _shift(rng: np.random.Generator, most: float) -> np.ndarray:
    return rng.uniform(-most, most, 3)
