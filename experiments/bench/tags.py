"""ArUco and AprilTag on card and slot: drawn, found by OpenCV, and made into poses.

Each disc is replaced by a tag in the square that the disc and its dark margin take: `SQUARE` wide
about the same centre, the tag's white margin of one cell within. So no method has more surface.
A body's pose is fitted to all corners of its tags in both images by the same maximum likelihood
that localizes a camera by its map (`perception.registration`).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.se3 import inverse_covariance, transport_covariance
from perception.markers.poses import BodyCad
from perception.registration.checks import RegistrationError
from perception.registration.closed_form import kabsch_pose
from perception.registration.likelihood import solve
from perception.registration.reprojection import KnownPoints, Pose, Sighting
from perception.stereo.geometry import StereoGeometry

SQUARE = 3.0 * CARD_AND_SLOT.marker_diameter
"""Edge of the square that a marker has to itself [m]: a disc, and a diameter of dark face on every
side. That is what our detectors look at around a disc at 1.1 m: four columns are 6.5 mm."""
TEXELS = 64
"""Texture pixels of a cell's edge, five for each pixel of an oversampled image at 0.35 m."""
_WHITE, _BLACK = 242, 13  # Of 255, as the discs' paint.
_ROWS = 3.0  # Largest difference of a corner's rows between the images [px].
FREEDOM = 8.0
"""Degrees of freedom that `TagFamily.sigma` counts for, beside the residuals of a fit."""


@dataclasses.dataclass(frozen=True)
class TagFamily:
    """A dictionary of OpenCV's and how its tags are looked for.

    Attributes:
        dictionary: Number of the dictionary in ``cv2.aruco``.
        cells: Number of cells along an edge, with the black border, without the white margin.
        refinement: Corner refinement of ``cv2.aruco``.
        offset: Column and row that OpenCV gives the centre of the first pixel [px].
        upscaling: Factor by which an image is enlarged before.
        sigma: Standard deviation of a corner's column and row [px].
    """

    dictionary: int
    cells: int
    refinement: int
    offset: float
    upscaling: int
    sigma: float

    def pattern(self, number: int) -> NDArray[np.bool_]:
        """Return (cells + 2, cells + 2), which cells of a tag and its margin are white."""
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        image = cv2.aruco.generateImageMarker(dictionary, number, self.cells)
        return np.pad(image > 0, 1, constant_values=True)

    def corners(self, centre: FloatArray) -> FloatArray:
        """Return (4, 3) corners of a tag's black border in OpenCV's order [m], body frame.

        Args:
            centre: (3,) centre of the tag [m], body frame.
        """
        half = 0.5 * SQUARE * self.cells / (self.cells + 2)
        return centre + half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])

    def detector(self) -> cv2.aruco.ArucoDetector:
        """Return OpenCV's detector."""
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = self.refinement
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        return cv2.aruco.ArucoDetector(dictionary, parameters)


FAMILIES: Final[Mapping[str, TagFamily]] = MappingProxyType(
    {
        name: TagFamily(dictionary, cells, cv2.aruco.CORNER_REFINE_APRILTAG, 0.5, 3, 0.065)
        for name, dictionary, cells in (
            ("aruco", cv2.aruco.DICT_4X4_50, 6),
            ("apriltag", cv2.aruco.DICT_APRILTAG_36h11, 8),
        )
    }
)
"""ArUco's dictionary with the largest cells, and the AprilTags that their makers recommend.

AprilTag's lines through the edges and threefold enlargement served both best on 32 other poses
(clean; per axis r.m.s. of the corners [px], tags found, processor time of a pair):

| refinement | enlarged | aruco | apriltag | time |
|---|---|---|---|---|
| none | 1 | 0.55, 83 % | 0.54, 79 % | 30 ms |
| sub-pixel corners | 1 / 3 | 0.46, 83 % / 0.30, 97 % | 0.52, 79 % / 0.32, 92 % | 30 / 70 ms |
| contour | 1 / 3 | 0.56, 83 % / 0.21, 97 % | 0.56, 79 % / 0.23, 92 % | 30 / 75 ms |
| AprilTag | 1 | 0.15, 52 % | 0.14, 45 % | 70 ms |
| AprilTag | 2 | 0.07, 87 % | 0.08, 88 % | 170 ms |
| AprilTag | 3 | 0.05, 92 % | 0.07, 95 % | 360 ms |

Fourfold enlargement gained no more and took 600 ms.
OpenCV gives AprilTag's corners half a pixel more than all others, and without that they are off by
0.005 px in the mean; the other refinements draw a tag's corners together. With 0.065 px the poses'
NEES is about 1.
"""


@dataclasses.dataclass(frozen=True)
class BodyPose:
    """Estimated pose of a body.

    Attributes:
        transform_body_to_camera: Pose of the body in the left camera's frame.
        covariance: (6, 6) covariance of xi, rotation [rad] then translation [m], in
            ``true = from_exp_coords(xi) * transform_body_to_camera``.
    """

    transform_body_to_camera: RigidTransform
    covariance: FloatArray


def numbers(body: int, cad: BodyCad) -> list[int]:
    """Return the numbers of a body's tags: card 0 and 1, slot 2 and 3."""
    return list(range(body * len(cad.points), (body + 1) * len(cad.points)))


def paint_tags(scene: mujoco.MjSpec, cads: Sequence[BodyCad], texels: int = TEXELS) -> None:
    """Add the tags of all families to card and slot, each family as a paint of its name.

    Args:
        scene: Scene with the bodies ``card`` and ``slot``.
        cads: Markers of card and slot.
        texels: Texture pixels of a cell's edge.
    """
    half = 0.5 * SQUARE
    sheet = scene.add_mesh(name="tag", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    sheet.uservert = [-half, -half, 0, half, -half, 0, half, half, 0, -half, half, 0]
    sheet.userface = [0, 1, 2, 0, 2, 3]
    # A texture's first row is at the top of the tag.
    sheet.usertexcoord = [0, 1, 1, 1, 1, 0, 0, 0]
    for name, family in FAMILIES.items():
        for index, (body, cad) in enumerate(zip(("card", "slot"), cads, strict=True)):
            for number, centre in zip(numbers(index, cad), cad.points, strict=True):
                _add_material(scene, f"{name}/{number}", family.pattern(number), texels)
                scene.body(body).add_geom(
                    name=f"{name}/{number}",
                    type=mujoco.mjtGeom.mjGEOM_MESH,
                    meshname="tag",
                    material=f"{name}/{number}",
                    # As high as the discs' faces.
                    pos=centre,
                    contype=0,
                    conaffinity=0,
                    mass=0.0,
                )


def _add_material(scene: mujoco.MjSpec, name: str, pattern: NDArray[np.bool_], texels: int) -> None:
    grey = np.kron(np.where(pattern, _WHITE, _BLACK), np.ones((texels, texels))).astype(np.uint8)
    texture = scene.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=len(grey),
        height=len(grey),
        nchannel=3,
    )
    texture.data = np.repeat(grey[..., None], 3, axis=2).tobytes()
    scene.add_material(name=name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def find_tags(image: ImageArray, family: TagFamily) -> dict[int, FloatArray]:
    """Return the corners (4, 2) [px] of the tags in an image by their numbers, each found once.

    Args:
        image: (H, W) uint8.
        family: Dictionary and how its tags are looked for.
    """
    scale = family.upscaling
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    corners, found, _ = family.detector().detectMarkers(large)
    if found is None:
        return {}
    ids = [int(number) for number in found.ravel()]
    return {
        # Enlarged pixels lie about the centre of the one that they were.
        number: (np.asarray(corner, dtype=float)[0] - family.offset + 0.5) / scale - 0.5
        for number, corner in zip(ids, corners, strict=True)
        if ids.count(number) == 1
    }


def fit_tags(
    seen: Sequence[Mapping[int, FloatArray]],
    known: Mapping[int, FloatArray],
    geometry: StereoGeometry,
    sigma: float,
) -> BodyPose | None:
    """Fit a body's pose to the corners of its tags in both images.

    The covariance is scaled by the residuals, for which `sigma` counts as `FREEDOM` more.

    Args:
        seen: Corners (4, 2) [px] by the tags' numbers, of the left and of the right image.
        known: Corners (4, 3) [m] of the body's tags, body frame.
        geometry: Geometry of the stereo pair.
        sigma: Standard deviation of a corner's column and row [px].

    Returns:
        The pose; None if no tag of the body is in both images, or no pose fits.
    """
    left, right = seen
    both = [
        number
        for number in known
        if number in left
        and number in right
        and np.abs(left[number][:, 1] - right[number][:, 1]).max() < _ROWS
        and (left[number][:, 0] > right[number][:, 0]).all()
    ]
    if not both:
        return None
    one, two, points = (
        np.concatenate([source[number] for number in both]) for source in (left, right, known)
    )
    # From midway between the cameras, columns and disparities are independent of each other.
    middle = np.column_stack([(one + two) / 2.0, one[:, 0] - two[:, 0]])
    sight = Sighting(middle, np.tile(sigma * np.sqrt([0.5, 0.5, 2.0]), (len(middle), 1)), geometry)
    exact = KnownPoints(points, np.zeros((len(points), 3, 3)))
    # A square may be laid on its image in two ways: the likelihood of all corners decides.
    laid = square_poses(middle[:4, :2], points[:4], geometry)
    starts = [kabsch_pose(points, sight.points(), np.ones(len(points)))]
    fits = []
    for start in starts + [Pose.of(pose.inv()) for pose in laid]:
        try:
            fits.append(solve(start, exact, sight))
        except (RegistrationError, np.linalg.LinAlgError):
            continue
    if not fits:
        return None
    fit = min(fits, key=lambda solution: solution.cost)
    # Rows of the two images agree: what they differ by is a residual as well.
    cost = fit.cost + float(np.sum((one[:, 1] - two[:, 1]) ** 2)) / (2.0 * sigma**2)
    scale = (FREEDOM + cost) / (FREEDOM + 4 * len(points) - 6)
    camera = fit.pose.transform()
    beside = RigidTransform.from_translation([geometry.baseline / 2.0, 0.0, 0.0])
    spread = transport_covariance(beside, inverse_covariance(camera, scale * fit.covariance))
    return BodyPose(beside * camera.inv(), spread)


def square_poses(
    seen: FloatArray, corners: FloatArray, geometry: StereoGeometry
) -> list[RigidTransform]:
    """Return the two poses in which a tag would look as it does in one image, the likelier first.

    Args:
        seen: (4, 2) corners of the tag [px].
        corners: (4, 3) corners of the tag [m], body frame, parallel to its x and y axes.
        geometry: Geometry of the camera.
    """
    centre = corners.mean(axis=0)
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        np.ascontiguousarray(corners - centre),
        np.ascontiguousarray(seen),
        geometry.matrix,
        None,
        flags=cv2.SOLVEPNP_IPPE_SQUARE,
    )
    poses = []
    for number in range(count):
        laid = np.concatenate([turns[number].ravel(), shifts[number].ravel()]).astype(float)
        if np.isfinite(laid).all():
            pose = RigidTransform.from_components(laid[3:], Rotation.from_rotvec(laid[:3]))
            poses.append(pose * RigidTransform.from_translation(-centre))
    return poses


def single_image_pose(
    seen: Mapping[int, FloatArray], known: Mapping[int, FloatArray], geometry: StereoGeometry
) -> RigidTransform | None:
    """Return a body's pose by the first of its tags in one image, as tags are commonly used.

    Args:
        seen: Corners (4, 2) [px] by the tags' numbers.
        known: Corners (4, 3) [m] of the body's tags, body frame.
        geometry: Geometry of the camera.
    """
    for number in known:
        if number in seen:
            poses = square_poses(seen[number], known[number], geometry)
            return poses[0] if poses else None
    return None
