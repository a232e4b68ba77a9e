"""Objects on a field besides rocks: textured blocks and screens, and a panel with markers.

The panel represents the solar panel that the thesis' robots set up. Its frame, in which its CAD
is given, lies in the middle of its face: x right and y up as one looks at the face, z out of it.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray, IndexArray

STRUT_RADIUS = 0.006
"""Radius of the two rods that hold the panel up [m]."""
_DISC = 2e-4  # Height of each disc of a marker above the surface below it [m].
_BALLAST = 0.45  # Depth of the ballast over the panel's height.
_SUNK = 0.005  # A block goes this deep into the ground, so that no gap shows on a slope [m].
_SAMPLED = 0.02  # Spacing of the points of the ground below a screen [m].


def finite(*values: float) -> bool:
    """Return whether all values are finite."""
    return all(math.isfinite(value) for value in values)


def require(condition: bool, what: str, value: object, valid: str) -> None:
    """Refuse a setting of a scene.

    Args:
        condition: Whether the value is valid.
        what: Name of the value.
        value: The value.
        valid: Description of valid values.

    Raises:
        ValueError: If the value is not valid.
    """
    if not condition:
        raise ValueError(f"{what}: got {value!r}, needs {valid}")


@dataclasses.dataclass(frozen=True)
class PanelMarker:
    """A white disc with a dark centre on the panel's face.

    Attributes:
        x: Centre's coordinate to the right in the face [m].
        y: Centre's coordinate upwards in the face [m].
        radius: Radius of the white disc [m].
        dark: Radius of the dark centre over that of the disc.
    """

    x: float
    y: float
    radius: float = 0.018
    dark: float = 0.4


MARKERS = (
    PanelMarker(-0.13, -0.10),
    PanelMarker(0.08, -0.07),
    PanelMarker(-0.15, 0.03),
    PanelMarker(0.16, 0.09),
)
"""Four markers whose six distances differ by 3 cm and more: no turn maps them onto themselves."""


@dataclasses.dataclass(frozen=True)
class PanelConfig:
    """A textured plate on the ground, held up by two rods behind it.

    Attributes:
        position: Middle of the lower front edge, x and y [m], world.
        yaw: About the vertical [rad]; at 0 its face looks along -y.
        tilt: Angle by which the panel is tilted back [rad]; 0 is upright.
        size: Width and height of the face [m].
        thickness: [m].
        markers: Discs on the face.
        ballast: Height of a textured box behind the face, between the rods' feet, by which a panel
            can be seen from aside and from behind [m]; 0 for none.
    """

    position: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    tilt: float = 0.35
    size: tuple[float, float] = (0.40, 0.30)
    thickness: float = 0.012
    markers: tuple[PanelMarker, ...] = MARKERS
    ballast: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible panels.

        Raises:
            ValueError: If a number is out of its range or a marker hangs over the edge.
        """
        pose, lengths = (*self.position, self.yaw), (*self.size, self.thickness)
        require(finite(*pose), "panel pose", pose, "finite numbers [m, rad]")
        require(0.0 <= self.tilt <= 1.2, "panel tilt", self.tilt, "0 to 1.2 rad")
        low = 0.0 <= self.ballast <= 0.5 * self.size[1]
        require(low, "panel ballast", self.ballast, "0 to half the face's height [m]")
        small = all(0.0 < length < 5.0 for length in lengths)
        require(small, "panel size", lengths, "positive lengths below 5 m")
        for index, marker in enumerate(self.markers):
            reach = np.abs([marker.x, marker.y]) + marker.radius
            round_and_dark = marker.radius > 0.0 and 0.0 < marker.dark < 1.0
            require(round_and_dark, f"panel marker {index}", marker, "dark within 0 to 1")
            inside = bool(np.all(reach <= np.asarray(self.size) / 2.0))
            require(inside, f"panel marker {index}", marker, "to lie on the face")

    @property
    def marker_points(self) -> FloatArray:
        """(N, 3) centres of the markers' dark discs, which stand out a little [m], panel frame."""
        return np.array([[m.x, m.y, 2.0 * _DISC] for m in self.markers]).reshape(-1, 3)

    @property
    def footprint(self) -> float:
        """Radius about `position` that is kept clear of rocks and blocks [m]."""
        return 0.5 * math.hypot(*self.size) + 0.02

    def transform_panel_to_world(self, ground: float) -> RigidTransform:
        """Return the pose of the panel's frame.

        Args:
            ground: Height of the ground at `position` [m].
        """
        turn = Rotation.from_euler("z", self.yaw) * Rotation.from_euler("x", np.pi / 2 - self.tilt)
        foot = np.array([*self.position, ground])
        middle = foot + turn.apply([0.0, self.size[1] / 2.0, 0.0])
        return RigidTransform.from_components(middle, turn)


@dataclasses.dataclass(frozen=True)
class ScreenConfig:
    """An upright textured box on the ground, which hides what is behind it: a wall or a pillar.

    Attributes:
        position: Middle of its footprint, x and y [m], world.
        yaw: About the vertical [rad]; at 0 its width lies along x.
        size: Width, depth and height [m]; the height is above the ground at its position.
    """

    position: tuple[float, float]
    yaw: float = 0.0
    size: tuple[float, float, float] = (0.9, 0.12, 0.6)

    def __post_init__(self) -> None:
        """Refuse impossible screens.

        Raises:
            ValueError: If a number is out of its range.
        """
        pose = (*self.position, self.yaw)
        require(finite(*pose), "screen pose", pose, "finite numbers [m, rad]")
        small = all(0.0 < length <= 5.0 for length in self.size)  # noqa: PLR2004
        require(small, "screen size", self.size, "positive lengths of at most 5 m")

    def footprint(self, spacing: float = math.inf) -> FloatArray:
        """Return points (N, 2) [m] of a grid over its footprint, among them the four corners.

        Args:
            spacing: Largest distance of the points along each edge [m].
        """
        lengths = self.size[:2]
        counts = [max(1, math.ceil(length / spacing)) + 1 for length in lengths]
        x, y = (np.linspace(-0.5, 0.5, n) * length for n, length in zip(counts, lengths))
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return grid @ np.array([[c, s], [-s, c]]) + self.position

    def distance(self, point: ArrayLike) -> float:
        """Return the distance of a point (2,) [m] from its footprint [m]; 0 within."""
        x, y = np.asarray(point, dtype=float) - self.position
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        beyond = np.abs([c * x + s * y, c * y - s * x]) - np.array(self.size[:2]) / 2.0
        return float(np.linalg.norm(np.maximum(beyond, 0.0)))

    @property
    def discs(self) -> FloatArray:
        """(N, 3) discs that cover its footprint: x and y of the middle, and radius [m]."""
        short, long = sorted(self.size[:2])
        count = max(1, math.ceil(long / short))
        radius = 0.5 * math.hypot(short, long / count)
        along = ((np.arange(count) + 0.5) / count - 0.5) * long
        yaw = self.yaw + (0.0 if self.size[0] >= self.size[1] else math.pi / 2)
        middles = np.outer(along, [math.cos(yaw), math.sin(yaw)]) + self.position
        return np.column_stack([middles, np.full(count, radius)])


@dataclasses.dataclass(frozen=True)
class Solids:
    """Boxes or ellipsoids that stand upright on the ground.

    Attributes:
        centres: (N, 3) [m], world.
        half_sizes: (N, 3) half edges or semi-axes [m], in each solid's own frame.
        yaws: (N,) rotation of that frame about the vertical [rad].
    """

    centres: FloatArray
    half_sizes: FloatArray
    yaws: FloatArray

    @property
    def radii(self) -> FloatArray:
        """(N,) radius of the upright cylinder about each box [m]."""
        return np.hypot(self.half_sizes[:, 0], self.half_sizes[:, 1])

    def above(
        self, points: FloatArray
    ) -> Iterator[tuple[float, FloatArray, IndexArray, FloatArray]]:
        """Yield each solid as the points see it that its cylinder holds.

        Args:
            points: (K, 2) [m], world.

        Yields:
            Height of the centre [m], half sizes (3,) [m], indices (L,) of the points, and these
            (2, L) [m] in the solid's own frame.
        """
        reach = self.radii * (1.0 + 1e-9)  # Corners lie on the cylinder.
        about = cKDTree(points).query_ball_point(self.centres[:, :2], reach)
        for centre, half, yaw, held in zip(
            self.centres, self.half_sizes, self.yaws, about, strict=True
        ):
            index = np.array(held, dtype=np.intp)
            x, y = (points[index] - centre[:2]).T
            along, across = x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)
            yield centre[2], half, index, np.stack([along, across])


NO_SOLIDS = Solids(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


def make_blocks(
    rng: np.random.Generator,
    size: tuple[float, float],
    ground_at: Callable[[FloatArray], FloatArray],
    count: int,
    edge: tuple[float, float],
    clear: FloatArray,
) -> Solids:
    """Put blocks on a field, none in another.

    Args:
        rng: Source of randomness.
        size: Lengths of the field along x and y [m], centred on the origin.
        ground_at: Height [m] of the ground at (N, 2) points [m].
        count: Number of blocks drawn; those that would stand in a cleared disc, in an earlier
            block or over the border are left out.
        edge: Smallest and largest edge [m]; small ones are more frequent.
        clear: (N, 3) discs without blocks: x and y of the centre, and radius [m].

    Returns:
        The blocks.
    """
    half = np.asarray(size) / 2.0
    places = rng.uniform(-half, half, (count, 2))
    half_sizes = edge[0] * (edge[1] / edge[0]) ** rng.uniform(0.0, 1.0, (count, 3)) / 2.0
    yaws = rng.uniform(-np.pi, np.pi, count)
    reach = np.hypot(half_sizes[:, 0], half_sizes[:, 1])
    kept: list[int] = []
    for index, place in enumerate(places):
        apart = np.linalg.norm(clear[:, :2] - place, axis=1) > clear[:, 2] + reach[index]
        others = np.linalg.norm(places[kept] - place, axis=1) > reach[kept] + reach[index]
        if np.all(apart) and np.all(others) and np.all(np.abs(place) + reach[index] <= half):
            kept.append(index)
    heights = ground_at(places[kept]) + half_sizes[kept, 2] - _SUNK
    return Solids(np.column_stack([places[kept], heights]), half_sizes[kept], yaws[kept])


def make_screens(
    screens: Sequence[ScreenConfig], ground_at: Callable[[FloatArray], FloatArray]
) -> Solids:
    """Put screens on a field, each down to the lowest ground below it, so that no gap shows.

    Args:
        screens: Screens to put.
        ground_at: Height [m] of the ground at (N, 2) points [m].
    """
    if not screens:
        return NO_SOLIDS
    places = np.array([screen.position for screen in screens])
    lengths = np.array([screen.size for screen in screens])
    tops = ground_at(places) + lengths[:, 2]
    bottoms = np.array([ground_at(screen.footprint(_SAMPLED)).min() for screen in screens]) - _SUNK
    half = np.column_stack([lengths[:, :2], tops - bottoms]) / 2.0
    yaws = np.array([screen.yaw for screen in screens])
    return Solids(np.column_stack([places, (tops + bottoms) / 2.0]), half, yaws)


def add_solids(
    scene: mujoco.MjSpec, name: str, kind: mujoco.mjtGeom, solids: Solids, material: str = ""
) -> None:
    """Add geoms to a scene, for instance ``block0``, ``block1``, ... of the material ``block``.

    Args:
        scene: Scene with the material.
        name: Name of each geom before its number.
        kind: Type of the geoms.
        solids: Solids to add.
        material: Name of the material; empty for that of the geoms.
    """
    for index, (centre, half, yaw) in enumerate(
        zip(solids.centres, solids.half_sizes, solids.yaws, strict=True)
    ):
        scene.worldbody.add_geom(
            name=f"{name}{index}",
            type=kind,
            pos=centre,
            size=half,
            quat=yaw_quaternion(yaw),
            material=material or name,
        )


def yaw_quaternion(yaw: float) -> list[float]:
    """Return the quaternion, w first, of a turn about the vertical [rad]."""
    return [math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)]


def add_panel(scene: mujoco.MjSpec, panel: PanelConfig, ground: float) -> None:
    """Add the fixed body ``panel``, whose frame is the panel's.

    Its geoms are ``panel_plate``, ``panel_strut0`` and ``1``, and for each marker the discs
    ``panel_marker0`` (white) and ``panel_marker0_centre`` (dark).

    Args:
        scene: Has a material ``panel``.
        panel: Panel to add.
        ground: Height of the ground at its position [m].
    """
    pose = panel.transform_panel_to_world(ground)
    body = scene.worldbody.add_body(
        name="panel", pos=pose.translation, quat=pose.rotation.as_quat(scalar_first=True)
    )
    width, height = panel.size
    body.add_geom(
        name="panel_plate",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, 0.0, -panel.thickness / 2.0],
        size=[width / 2.0, height / 2.0, panel.thickness / 2.0],
        material="panel",
    )
    for index, marker in enumerate(panel.markers):
        discs = (("", marker.radius, 0.95, 1), ("_centre", marker.radius * marker.dark, 0.03, 2))
        for ending, radius, grey, layer in discs:
            body.add_geom(
                name=f"panel_marker{index}{ending}",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=[marker.x, marker.y, 0.0],
                size=[radius, _DISC * layer, 0.0],
                rgba=[grey, grey, grey, 1.0],
                contype=0,
                conaffinity=0,
            )
    top = np.array([0.0, height / 3.0, -panel.thickness])
    for index, side in enumerate((-1.0, 1.0)):
        upper = top + [side * width / 3.0, 0.0, 0.0]
        lower = pose.apply(upper)
        behind = pose.rotation.apply([0.0, 0.0, -1.0]) * [1.0, 1.0, 0.0]
        lower += 0.35 * height * behind / np.linalg.norm(behind)
        lower[2] = ground
        body.add_geom(
            name=f"panel_strut{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*upper, *pose.inv().apply(lower)],
            size=[STRUT_RADIUS, 0.0, 0.0],
            rgba=[0.6, 0.6, 0.62, 1.0],
        )
    if panel.ballast > 0.0:
        _add_ballast(scene, panel, ground)


def _add_ballast(scene: mujoco.MjSpec, panel: PanelConfig, ground: float) -> None:
    """Add the box behind a panel, upright on the ground."""
    depth = _BALLAST * panel.size[1]
    behind = 0.5 * depth + panel.thickness + panel.ballast * math.tan(panel.tilt)
    x, y = panel.position
    scene.worldbody.add_geom(
        name="panel_ballast",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[x - behind * math.sin(panel.yaw), y + behind * math.cos(panel.yaw),
             ground + panel.ballast / 2.0 - _SUNK],
        size=[0.4 * panel.size[0], depth / 2.0, panel.ballast / 2.0 + _SUNK],
        quat=yaw_quaternion(panel.yaw),
        material="panel",
    )  # fmt: skip
