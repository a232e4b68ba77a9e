"""What may be asked of a scene: the field, the robots on it and what they carry."""

import dataclasses
import math
import re
from collections.abc import Sequence

import numpy as np

from models.as_made import AsMade
from models.clutter import PanelConfig, ScreenConfig, finite, require
from models.datasheets import ROVER
from perception.geometry.arrays import FloatArray

START_RADIUS = 0.4
"""Radius about a robot's start that is clear of rocks and blocks [m]."""
SUN_ELEVATION = (math.radians(20.0), math.radians(70.0))
"""Elevations of a sun that shines from morning to evening [rad]."""
STEEPEST = math.radians(20.0)
"""Steepest slope along each axis of a field [rad]: beyond it an inclinometer's masses stop."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclasses.dataclass(frozen=True)
class FieldConfig:
    """A field to drive on.

    Attributes:
        size: Lengths along x and y [m], centred on the origin. Flat ground goes on beyond it.
        relief: Standard deviation of the ground's height [m]; 0 is flat.
        cell: Spacing of the height field's grid [m].
        rocks: Number of rocks drawn; those within 0.4 m of a robot's start are left out.
        rock_radius: Smallest and largest horizontal semi-axis of a rock [m].
        friction: Coulomb coefficient between all tyres and this ground, where it is known; None for
            that of each robot's own tyres.
        friction_patches: Lowest and highest Coulomb coefficient of ground that differs from patch
            to patch, in place of `friction`; None for ground that is alike everywhere.
        friction_patch: Edge of such a patch [m].
        seed: Seed of texture, heights, rocks, blocks and patches.
        texture_pixels: Edge of the noise texture; a power of two.
        texture_tile: Edge of what that texture covers before it repeats [m].
        blocks: Number of textured blocks drawn; those within 0.4 m of a robot's start, before the
            panel or in another block are left out.
        block_edge: Smallest and largest edge of a block [m].
        screens: Walls and pillars that hide what is behind them, clear of rocks and blocks.
        clear: Discs that are kept free of drawn rocks and blocks, as where a robot has to stand to
            do its work: x and y of the middle, and radius [m].
        panel: The panel that is the robots' target, if any.
        slot_width: Distance between the walls of the slot at the origin [m]; None for no slot.
        card_guides: Whether the slot is of card guides with a connector, its width that between the
            floors of their grooves, and the cards of robots give way in their grippers.
        shadows: Whether lights cast shadows, which take half of an image's rendering time.
        sun_elevation: Lowest and highest elevation of the sun [rad], drawn with its azimuth from
            the seed; None for one sun of all fields, whose shadows end 1 m from the origin.
        slope: Angles by which the field's x and y axes rise above the horizontal [rad], each within
            `STEEPEST`. Site, robots and ground lie on one inclined plane, and nothing but the
            direction of gravity shows it: so gravity is turned, and all coordinates stay those of
            the plane, z normal to it.
    """

    size: tuple[float, float] = (6.0, 6.0)
    relief: float = 0.0
    cell: float = 0.05
    rocks: int = 0
    rock_radius: tuple[float, float] = (0.02, 0.06)
    friction: float | None = None
    friction_patches: tuple[float, float] | None = None
    friction_patch: float = 0.6
    seed: int = 0
    texture_pixels: int = 1024
    texture_tile: float = 0.25
    blocks: int = 0
    block_edge: tuple[float, float] = (0.05, 0.16)
    screens: tuple[ScreenConfig, ...] = ()
    clear: tuple[tuple[float, float, float], ...] = ()
    panel: PanelConfig | None = None
    slot_width: float | None = None
    card_guides: bool = False
    shadows: bool = True
    sun_elevation: tuple[float, float] | None = None
    slope: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse impossible fields.

        Raises:
            ValueError: If a number is out of its range.
        """
        require(
            finite(*self.size) and min(self.size) > 0.0,
            "field size",
            self.size,
            "two positive lengths [m]",
        )
        require(0.0 <= self.relief <= 1.0, "field relief", self.relief, "0 to 1 m")
        require(0.01 <= self.cell <= 1.0, "field cell", self.cell, "0.01 to 1 m")
        require(0 <= self.rocks <= 20000, "field rocks", self.rocks, "0 to 20000")
        low, high = self.rock_radius
        require(0.0 < low <= high, "field rock_radius", self.rock_radius, "0 < low <= high [m]")
        if self.friction is not None:
            require(
                0.0 < self.friction <= 3.0, "field friction", self.friction, "above 0, at most 3"
            )
        if self.friction_patches is not None:
            low, high = self.friction_patches
            require(
                self.friction is None and 0.0 < low <= high <= 3.0,
                "field friction_patches",
                self.friction_patches,
                "0 < low <= high <= 3, and no one friction beside it",
            )
        require(
            0.05 <= self.friction_patch <= 100.0,
            "field friction_patch",
            self.friction_patch,
            "0.05 to 100 m",
        )
        power = self.texture_pixels > 0 and self.texture_pixels & (self.texture_pixels - 1) == 0
        require(
            power and 16 <= self.texture_pixels <= 4096,
            "field texture_pixels",
            self.texture_pixels,
            "a power of two from 16 to 4096",
        )
        require(
            0.01 <= self.texture_tile <= 10.0,
            "field texture_tile",
            self.texture_tile,
            "a tile of 0.01 to 10 m",
        )
        require(0 <= self.blocks <= 2000, "field blocks", self.blocks, "0 to 2000")
        low, high = self.block_edge
        require(0.0 < low <= high <= 2.0, "field block_edge", self.block_edge, "0 < low <= high")
        for disc in self.clear:
            whole = len(disc) == 3 and finite(*disc) and disc[2] > 0.0  # noqa: PLR2004
            require(whole, "field clear", disc, "x, y and a positive radius [m]")
        low, high = self.sun_elevation or SUN_ELEVATION
        require(
            0.0 < low <= high <= 0.5 * math.pi,
            "field sun_elevation",
            self.sun_elevation,
            "0 < low <= high <= pi / 2",
        )
        # A comparison with NaN is false.
        gentle = len(self.slope) == 2 and all(abs(angle) <= STEEPEST for angle in self.slope)
        require(gentle, "field slope", self.slope, "two angles within 20 degrees [rad]")

    @property
    def up(self) -> FloatArray:
        """(3,) unit vector against gravity, in the field's coordinates."""
        x, y = math.sin(self.slope[0]), math.sin(self.slope[1])
        return np.array([x, y, math.sqrt(1.0 - x**2 - y**2)])


FLAT = FieldConfig()
"""Flat textured ground."""
LABORATORY = FieldConfig(friction=ROVER.tyre_friction)
"""The thesis' laboratory: flat ground on which every robot's tyres grip as drawn."""
ROUGH = FieldConfig(relief=0.03, rocks=1500, rock_radius=(0.025, 0.07))
"""Rolling ground with rocks of a few centimetres, some 40 a square metre."""


@dataclasses.dataclass(frozen=True)
class PayloadConfig:
    """A homogeneous box held in the gripper.

    Attributes:
        mass: Mass of the box [kg].
        centre: Centre of the box from the grip point, in the wrist's frame [m].
        half_size: Half of its edges [m].
        taken: Time from which the gripper bears its weight [s]; before, it weighs nothing.
    """

    mass: float
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half_size: tuple[float, float, float] = (0.02, 0.02, 0.02)
    taken: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible payloads.

        Raises:
            ValueError: If mass or size is not positive, or the time is negative.
        """
        require(0.0 < self.mass < math.inf, "payload mass", self.mass, "a positive mass [kg]")
        require(finite(*self.centre), "payload centre", self.centre, "three finite numbers [m]")
        require(
            finite(*self.half_size) and min(self.half_size) > 0.0,
            "payload half_size",
            self.half_size,
            "three positive lengths [m]",
        )
        require(
            0.0 <= self.taken < math.inf, "payload taken", self.taken, "a time of 0 or later [s]"
        )


@dataclasses.dataclass(frozen=True)
class RobotPlacement:
    """One robot of a scene.

    Attributes:
        name: Prefix of its names, without the slash; letters, digits and underscores.
        position: Start of its centre of gravity in x and y [m], world.
        yaw: Start heading about the vertical [rad]; 0 looks along the world's y.
        arm: Whether the rover carries the arm.
        stereo: Whether the arm's stereo head renders images; if not, its housings are ballast.
        centre_locked: Whether the centre joint is held at zero.
        payload: Box in the gripper, if any.
        card: Whether the gripper holds the card.
        mast: Height by which the stereo head is raised above its place on the wrist [m]: from
            65 mm on it looks over a card in the gripper, which otherwise hides half of each image.
        patterned: Whether its decks bear the pattern of blocks, so that stereo matching sees them;
            on a field with blocks or screens.
        model: MJCF file of a robot of your own in place of the thesis' rover, in the same naming:
            the free body ``chassis``, the arm's first body ``arm_base_link``, motors ``x`` on
            joints ``x_joint``. Its key frame ``home`` is how it starts, at rest on level ground.
        made: How it was made from its drawing; None for a robot that is its drawing. What it holds
            (payload, card) is as drawn.
    """

    name: str = "rover1"
    position: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    arm: bool = True
    stereo: bool = True
    centre_locked: bool = False
    payload: PayloadConfig | None = None
    card: bool = False
    mast: float = 0.0
    patterned: bool = False
    model: str = ""
    made: AsMade | None = None

    def __post_init__(self) -> None:
        """Refuse impossible robots.

        Raises:
            ValueError: If the name cannot be a prefix, there is a payload or a card but no arm, or
                both at once, or what is the thesis' rover's is asked of another model.
        """
        require(
            _NAME.fullmatch(self.name) is not None,
            "robot name",
            self.name,
            "a letter, then letters, digits and underscores",
        )
        start = (*self.position, self.yaw)
        require(finite(*start), f"start of {self.name}", start, "finite numbers [m, rad]")
        require(self.arm or self.payload is None, f"payload of {self.name}", self.payload, "an arm")
        held = self.arm and self.payload is None
        require(0.0 <= self.mast <= 0.3, f"mast of {self.name}", self.mast, "0 to 0.3 m")  # noqa: PLR2004
        asked = self.arm, self.stereo, self.centre_locked, self.payload, self.card, self.made
        extras = self.mast, self.patterned
        require(
            not self.model
            or (*asked, *extras) == (True, True, False, None, False, None, 0.0, False),
            f"model of {self.name}",
            self.model,
            "nothing but name, position and yaw beside it",
        )
        require(held or not self.card, f"card of {self.name}", self.card, "an arm without payload")


def check_robots(field: FieldConfig, robots: Sequence[RobotPlacement]) -> None:
    """Refuse robots of one name or off the field, and what of them the field has not or overrides.

    Args:
        field: The field.
        robots: All robots on it.

    Raises:
        ValueError: Naming the robot.
    """
    names = [robot.name for robot in robots]
    for robot in robots:
        if names.count(robot.name) > 1:
            raise ValueError(
                f"two robots are called {robot.name!r}; names given: {', '.join(names)}; "
                f"free, for example: {_free_name(names)}"
            )
        reach = np.abs(np.asarray(robot.position)) + 0.3
        if np.any(reach > np.asarray(field.size) / 2.0):
            raise ValueError(
                f"robot {robot.name!r} starts at {robot.position}, less than 0.3 m from the edge "
                f"of the field of {field.size[0]} x {field.size[1]} m"
            )
        grained = field.blocks > 0 or field.screens
        if robot.patterned and not grained:
            raise ValueError(
                f"robot {robot.name!r} is patterned as blocks are: expected a field with blocks or "
                "screens"
            )
        told = field.friction is not None or field.friction_patches is not None
        if told and robot.made is not None and robot.made.change.worn_wheel:
            raise ValueError(
                f"robot {robot.name!r} has a worn tyre, of which nothing shows where the field "
                "says the friction of all tyres: expected one without friction and friction_patches"
            )


def check_panel(field: FieldConfig, robots: Sequence[RobotPlacement]) -> None:
    """Refuse a panel that hangs over the field's edge or overlaps a robot's start.

    Args:
        field: The field, perhaps with a panel.
        robots: All robots on it.

    Raises:
        ValueError: Naming the panel or the robot.
    """
    panel = field.panel
    if panel is None:
        return
    reach = np.abs(np.asarray(panel.position)) + panel.footprint
    if np.any(reach > np.asarray(field.size) / 2.0):
        raise ValueError(
            f"the panel stands at {panel.position}, less than {panel.footprint:.2f} m from the "
            f"edge of the field of {field.size[0]} x {field.size[1]} m"
        )
    least = panel.footprint + START_RADIUS
    for robot in robots:
        distance = math.dist(robot.position, panel.position)
        if distance < least:
            raise ValueError(
                f"robot {robot.name!r} starts {distance:.2f} m from the panel; "
                f"needs {least:.2f} m or more"
            )


def check_screens(field: FieldConfig, robots: Sequence[RobotPlacement]) -> None:
    """Refuse screens that hang over the field's edge or overlap a robot's start or the panel.

    Args:
        field: The field, perhaps with screens.
        robots: All robots on it.

    Raises:
        ValueError: Naming the screen, and the robot or the panel.
    """
    kept = [(f"the start of robot {r.name!r}", r.position, START_RADIUS) for r in robots]
    if field.panel is not None:
        kept.append(("the panel", field.panel.position, field.panel.footprint))
    for index, screen in enumerate(field.screens):
        if np.any(np.abs(screen.footprint()) > np.asarray(field.size) / 2.0):
            raise ValueError(
                f"screen {index} at {screen.position} stands over the edge of the field of "
                f"{field.size[0]} x {field.size[1]} m"
            )
        for what, position, least in kept:
            distance = screen.distance(position)
            if distance < least:
                raise ValueError(
                    f"screen {index} at {screen.position} stands {distance:.2f} m from {what}; "
                    f"needs {least:.2f} m or more"
                )


def _free_name(names: Sequence[str]) -> str:
    return next(name for name in (f"rover{i}" for i in range(1, 1000)) if name not in names)
