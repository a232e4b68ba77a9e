"""Best view of card and slot for the master's camera, within reach of its arm.

The target is the region between card and slot with the markers of both (thesis figures 5-2, 5-3):
all of them must be in both images, not occluded by the card's holder.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.arm_inverse import standing_views
from controllers.kinematics.serial_chain import SerialChain
from controllers.placement.spatial.occluders import TargetField, expand, occluders_of_points
from controllers.placement.spatial.search import rate_positions
from controllers.placement.task import Exponents, Lens, Occluder, PlacementError, Target
from perception.geometry.arrays import FloatArray
from perception.markers.poses import BodyCad
from perception.stereo.geometry import StereoGeometry

_HEAD = 0.04  # Radius of spheres about the eyes and the middle between them that hold the head [m].
_MARGIN, _SEVERAL = 0.05, 3
"""Distance that arm and head keep from what is mapped [m], and how many points of it count."""
_AS_GOOD = 0.95  # Ratio to the best rating from which views count as equal.


@dataclasses.dataclass(frozen=True)
class WatchPlan:
    """Candidate camera poses and their rating.

    Attributes:
        lens: Field of view and range of the camera.
        carrier: (K, 3) corners of the card's holder [m], card frame.
        stand: (L, 3) corners of the slot's holder [m], slot frame.
        distances: (R,) candidate distances of the camera from the target [m].
        pitches: (S,) candidate pitches of the view above the horizon [rad].
        border: Least distance of markers from the images' edges [px].
        unsure: How much farther from the edges markers have to be that were not seen yet [px]:
            three deviations of a map's 5 mm at 0.45 m, and 20 mrad of the arm.
        slant: Largest angle between a face with markers and the line of sight of either eye [rad];
            detectors take markers up to 66 degrees.
        exponents: Exponents of eq. 4-1.
    """

    lens: Lens
    carrier: FloatArray
    stand: FloatArray
    distances: FloatArray
    pitches: FloatArray
    border: float = 14.0
    unsure: float = 36.0
    slant: float = math.radians(62.0)
    exponents: Exponents = dataclasses.field(default_factory=Exponents)


@dataclasses.dataclass(frozen=True)
class SeenParts:
    """Poses of card and slot in one frame, with their markers.

    Attributes:
        card_pose: Transform from the card to the frame.
        slot_pose: Transform from the slot to the frame.
        card: Markers of the card.
        slot: Markers of the slot.
    """

    card_pose: RigidTransform
    slot_pose: RigidTransform
    card: BodyCad
    slot: BodyCad

    def markers(self) -> FloatArray:
        """Return (N, 3) all markers [m]."""
        parts = (self.card_pose, self.card), (self.slot_pose, self.slot)
        return np.concatenate([pose.apply(cad.points) for pose, cad in parts])

    def normals(self) -> FloatArray:
        """Return (N, 3) unit vectors out of the faces of these markers."""
        parts = (self.card_pose, self.card), (self.slot_pose, self.slot)
        return np.concatenate(
            [np.tile(pose.rotation.apply(cad.normal), (len(cad.points), 1)) for pose, cad in parts]
        )


@dataclasses.dataclass(frozen=True)
class ArmChoice:
    """Best view within reach of the arm.

    Attributes:
        angles: (4,) joint angles [rad].
        rating: Rating of the best view; 0 if no view has all markers.
        rating_now: Rating of the view from the present angles.
        whole: Whether it is of card and slot; if not, of the card alone.
    """

    angles: FloatArray
    rating: float
    rating_now: float
    whole: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Surroundings:
    """What is mapped about an arm with a camera, card and slot, in one frame with them.

    Attributes:
        points: (K, 3) points that the arm may not touch [m].
        occluders: What stands before card and slot, as convex pieces.
    """

    points: FloatArray
    occluders: Sequence[Occluder]

    @classmethod
    def of(
        cls, points: FloatArray, before: FloatArray | None = None, voxel: float = 0.01
    ) -> "Surroundings":
        """Return the surroundings that points (K, 3) [m] show.

        Args:
            points: Points of obstacles.
            before: (L, 3) those of them that stand before card and slot [m]; None for all.
            voxel: Edge of the voxels of which occluders are made [m].
        """
        return cls(points, occluders_of_points(points if before is None else before, voxel))

    def touched(self, spheres: FloatArray) -> NDArray[np.bool_]:
        """Return (N,), whether one of K spheres (N, K, 4) is within `_MARGIN` of several points."""
        if not len(self.points):
            return np.zeros(len(spheres), dtype=bool)
        counts = cKDTree(self.points).query_ball_point(
            spheres[..., :3], spheres[..., 3] + _MARGIN, return_length=True
        )
        return np.asarray(counts).max(axis=1) >= _SEVERAL


def arm_spheres(arm: SerialChain, baseline: float, angles: FloatArray) -> FloatArray:
    """Return spheres (N, K, 4) that hold arm and stereo head, centre and radius, robot frame [m].

    Args:
        arm: Arm with the left camera as its tool.
        baseline: Distance between the eyes [m].
        angles: (N, joints) joint angles [rad].
    """
    links, cameras = arm.cover_points(angles), arm.tool_in_robot(angles)
    across = cameras.rotation.as_matrix()[:, None, :, 0] * np.linspace(0.0, baseline, 3)[:, None]
    eyes = np.asarray(cameras.translation)[:, None] + across
    centres = np.concatenate([links, eyes], axis=1)
    radii = np.repeat([arm.cover_radius, _HEAD], [links.shape[1], eyes.shape[1]])
    return np.concatenate(
        [centres, np.broadcast_to(radii[:, None], (*centres.shape[:2], 1))], axis=2
    )


def hides_itself(
    arm: SerialChain, baseline: float, angles: FloatArray, points: FloatArray
) -> NDArray[np.bool_]:
    """Return (N,), whether the arm hides one of points (K, 3) from one of its head's eyes.

    Args:
        arm: Arm with the left camera as its tool.
        baseline: Distance between the eyes [m].
        angles: (N, joints) joint angles [rad].
        points: Points in the robot frame [m].
    """
    own = len(arm.joints[-1].cover_points)  # The last link holds the head, which sees past it.
    links, cameras = arm.cover_points(angles)[:, :-own], arm.tool_in_robot(angles)
    across = baseline * cameras.rotation.as_matrix()[:, :, 0]
    hidden = np.zeros(len(angles), dtype=bool)
    for eyes in (np.asarray(cameras.translation), np.asarray(cameras.translation) + across):
        for point in points:
            way = point - eyes
            length = np.linalg.norm(way, axis=1)[:, None]
            away = links - eyes[:, None]
            along = np.clip(np.einsum("nki,ni->nk", away, way) / length, 0.0, length)
            off = np.linalg.norm(away - (along / length)[..., None] * way[:, None], axis=2)
            hidden |= np.any(off < arm.cover_radius, axis=1)
    return hidden


def target_field(
    plan: WatchPlan, parts: SeenParts, whole: bool = True, others: Sequence[Occluder] = ()
) -> TargetField:
    """Return the target between card and slot with its occluders.

    Args:
        plan: Shapes of the holders of card and slot.
        parts: Poses of card and slot, in any frame.
        whole: Whether the target is both card and slot; if not, the card alone.
        others: Further occluders, in the same frame.

    Raises:
        PlacementError: If the target lies in an occluder.
    """
    markers = parts.markers() if whole else parts.card_pose.apply(parts.card.points)
    middle = 0.5 * (markers.max(axis=0) + markers.min(axis=0))
    normals = [parts.card_pose.rotation.apply(parts.card.normal),
               parts.slot_pose.rotation.apply(parts.slot.normal)]  # fmt: skip
    normal = np.sum(normals, axis=0)
    normal /= np.linalg.norm(normal)
    target = Target("card and slot", middle, normal, markers - middle)
    occluders = [
        Occluder("carrier", parts.card_pose.apply(plan.carrier)),
        Occluder("stand", parts.slot_pose.apply(plan.stand)),
        *others,
    ]
    return expand(target, occluders)


def best_angles(
    plan: WatchPlan,
    parts: SeenParts,
    arm: SerialChain,
    geometry: StereoGeometry,
    now: FloatArray,
    sure: bool = True,
    farthest: float = math.inf,
    about: Surroundings | None = None,
) -> ArmChoice:
    """Return the joint angles with the best view of card and slot, or if none shows both, the card.

    Args:
        plan: Candidate camera poses.
        parts: Poses of card and slot, robot frame.
        arm: Arm with the camera.
        geometry: Geometry of the camera's stereo pair.
        now: (4,) present joint angles to compare with [rad].
        sure: Whether the poses were seen, and are no mere priors.
        farthest: Longest way of a joint [rad].
        about: What hides card and slot, and is not to be touched, robot frame; None for nothing.
    """
    wider = dataclasses.replace(plan, border=plan.border + plan.unsure)
    views = [(plan, True), (plan, False)]
    if not sure:
        views = [(wider, True), (plan, True), (wider, False), (plan, False)]
    choices = (
        _best_of(kept, parts, arm, geometry, now, farthest, whole, about) for kept, whole in views
    )
    return next((c for c in choices if c.rating > 0.0), ArmChoice(now, 0.0, 0.0, False))


def _best_of(
    plan: WatchPlan,
    parts: SeenParts,
    arm: SerialChain,
    geometry: StereoGeometry,
    now: FloatArray,
    farthest: float,
    whole: bool,
    about: Surroundings | None,
) -> ArmChoice:
    """Return the best view of card and slot, or of the card alone, which moves."""
    try:
        field = target_field(plan, parts, whole, about.occluders if about else ())
    except PlacementError:
        return ArmChoice(now, 0.0, 0.0, whole)
    views = standing_views(arm, field.target.position, plan.distances, plan.pitches)
    near = np.abs(views.angles - now).max(axis=1) <= farthest
    angles = np.vstack([now, views.angles[near & above_its_foot(arm, views.angles)]])
    cameras = arm.tool_in_robot(angles)
    count = None if whole else len(parts.card.points)
    markers, normals = parts.markers()[:count], parts.normals()[:count]
    seen = in_both_images(cameras, markers, geometry, plan.border)
    places = np.asarray(cameras.translation)
    right = places + geometry.baseline * cameras.rotation.as_matrix()[:, :, 0]
    for eyes in (places, right):
        seen &= slants(eyes, markers, normals) < plan.slant
    rated = rate_positions(field, plan.lens, places, None, plan.exponents)
    ratings = np.where(seen, [view.rating for view in rated], 0.0)
    ratings[hides_itself(arm, geometry.baseline, angles, markers)] = 0.0
    if about is not None:
        others = rate_positions(field, plan.lens, right, None, plan.exponents)
        ratings[[view.rating == 0.0 for view in others]] = 0.0
        ratings[about.touched(arm_spheres(arm, geometry.baseline, angles))] = 0.0
    # Of equally good views, the one nearest to the arm's present angles.
    good = np.flatnonzero(ratings >= _AS_GOOD * ratings.max())
    best = int(good[np.argmin(np.abs(angles[good] - now).max(axis=1))])
    return ArmChoice(angles[best], float(ratings[best]), float(ratings[0]), whole)


def slants(eyes: FloatArray, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the largest angles (N,) between faces and the lines of sight to them [rad].

    Args:
        eyes: (N, 3) positions of eyes [m].
        points: (K, 3) points on the faces [m].
        normals: (K, 3) unit vectors out of the faces.
    """
    sights = eyes[:, None] - points
    sights /= np.linalg.norm(sights, axis=2)[..., None]
    return np.arccos(np.clip(np.einsum("nki,ki->nk", sights, normals), -1.0, 1.0)).max(axis=1)


def above_its_foot(arm: SerialChain, angles: FloatArray) -> NDArray[np.bool_]:
    """Return (N,), whether the arm is above its base plane at joint angles (N, joints) [rad].

    Below are deck and ground: an arm that reaches there lifts its own robot.
    """
    if not len(angles):
        return np.zeros(0, dtype=bool)
    foot = float(arm.transform_base_to_robot.translation[2])
    return arm.cover_points(angles)[..., 2].min(axis=1) > foot + arm.cover_radius


def in_both_images(
    cameras: RigidTransform, points: FloatArray, geometry: StereoGeometry, border: float
) -> NDArray[np.bool_]:
    """Return for each of N cameras whether all points (K, 3) are within both images.

    Args:
        cameras: Transforms from the left camera to the points' frame.
        points: (K, 3) points [m].
        geometry: Geometry of the stereo pair.
        border: Width of the images' margin that is excluded [px].
    """
    rotations = cameras.rotation.as_matrix()
    local = np.einsum("nji,nkj->nki", rotations, points - cameras.translation[:, None])
    column, row, disparity = np.moveaxis(geometry.project(local), -1, 0)
    fits = (local[..., 2] > 0.05) & (row > border) & (row < geometry.height - 1 - border)
    for place in (column, column - disparity):
        fits &= (place > border) & (place < geometry.width - 1 - border)
    return fits.all(axis=1)
