"""A camera placement in space as a recording for the rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from controllers.placement.spatial.best_first import direction_tree
from controllers.placement.spatial.field import signed_caps
from controllers.placement.spatial.occluders import TargetField
from controllers.placement.task import View
from models.blocks import Block
from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray
from twin.layout import scene_view, side_by_side

_QUALITY = 80


def record_placement(
    path: Path, field: TargetField, blocks: Sequence[Block],
    cloud: tuple[FloatArray, FloatArray], views: Sequence[View],
    images: Sequence[NDArray[np.uint8]], aim: FloatArray,
) -> None:  # fmt: skip
    """Write the scene, the hulls, the sphere projection, the rated poses and the chosen view.

    Args:
        path: File to write, ``.rrd``.
        field: The target with its expanded hulls.
        blocks: Blocks as the planner estimates them.
        cloud: (N, 3) places [m], world, and (N,) their ratings.
        views: The chosen one first; each is a step of the recording, the chosen one its last.
        images: (height, width, 3) what they see.
        aim: (3,) what they look at [m], world.
    """
    stream = rr.RecordingStream("fieldtwin")
    stream.save(path)
    stream.send_blueprint(_blueprint())
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for block in blocks:
        stream.log(f"scene/blocks/{block.name}", _mesh(block.corners, (190, 150, 110)), static=True)
    for name, shape in zip(field.names, field.shapes):
        lines = rr.LineStrips3D(_edges(shape), colors=[90, 140, 220], radii=0.0003)
        stream.log(f"scene/hulls/{name}", lines, static=True)
    rim = field.target.position + field.target.outline
    closed = rr.LineStrips3D([np.vstack([rim, rim[:1]])], colors=[255, 60, 60], radii=0.0006)
    stream.log("scene/target", closed, static=True)
    places, ratings = cloud
    good = ratings > 0.0
    colours = _colours(ratings[good] / ratings.max())
    dots = rr.Points3D(places[good], colors=colours, radii=0.0015)
    stream.log("scene/ratings", dots, static=True)
    _sphere(stream, field, views[0].distance)
    # The chosen view comes last, where the viewer opens a recording.
    for step, (view, image) in enumerate(list(zip(views, images))[::-1]):
        stream.reset_time()
        stream.set_time("sim_time", duration=float(step))
        stream.set_time("step", sequence=step)
        _camera(stream, view, image, aim)
    stream.flush()
    stream.disconnect()


def _sphere(stream: rr.RecordingStream, field: TargetField, radius: float) -> None:
    """Log the sphere of the chosen distance: the free cap as colour, hidden parts dark."""
    ways = direction_tree(5).leaves
    places = field.to_world(radius * ways)
    caps = signed_caps(field, places) / (0.5 * np.pi)
    colours = np.where(caps[:, None] > 0.0, _colours(caps), [40, 40, 40])
    dots = rr.Points3D(places, colors=colours.astype(np.uint8), radii=0.0016)
    stream.log("sphere", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("sphere/free_cap", dots, static=True)


def _camera(
    stream: rr.RecordingStream, view: View, image: NDArray[np.uint8], aim: FloatArray
) -> None:
    ahead = (aim - view.position) / np.linalg.norm(aim - view.position)
    up = np.array([0.0, 0.0, 1.0]) if abs(ahead[2]) < 0.999 else np.array([-1.0, 0.0, 0.0])  # noqa: PLR2004
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    turn = np.column_stack([right, np.cross(ahead, right), ahead])
    stream.log("scene/camera", rr.Transform3D(translation=view.position, mat3x3=turn))
    lens = rr.Pinhole(
        image_from_camera=CAMERA.pinhole.matrix,
        resolution=[CAMERA.width, CAMERA.height],
        image_plane_distance=0.06,
    )
    stream.log("scene/camera", lens)
    quality = [int(cv2.IMWRITE_JPEG_QUALITY), _QUALITY]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), quality)
    packed = rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")
    stream.log("scene/camera/image", packed)
    for name, value in (("rating", view.rating), ("free_cap_deg", np.rad2deg(view.free_cap))):
        stream.log(f"curves/{name}", rr.Scalars(float(value)))


def _mesh(points: FloatArray, colour: Sequence[int]) -> rr.Mesh3D:
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    # The hull's triangles are turned any way; the viewer wants them counter-clockwise.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normals * hull.equations[:, :3], axis=1) < 0.0
    corners[inward] = corners[inward][:, ::-1]
    flat = np.repeat(hull.equations[:, :3], 3, axis=0)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=flat,
        vertex_colors=np.tile(np.array(colour, np.uint8), (3 * len(corners), 1)),
    )


def _edges(points: FloatArray) -> list[FloatArray]:
    """Return (2, 3) ends of each edge of the hull of points at which its surface bends."""
    hull = ConvexHull(points)
    normals = hull.equations[:, :3]
    return [
        points[np.delete(hull.simplices[face], corner)]
        for face, row in enumerate(hull.neighbors)
        for corner, other in enumerate(row)
        if other > face and normals[face] @ normals[other] < 0.9999  # noqa: PLR2004
    ]


def _colours(parts: FloatArray) -> NDArray[np.uint8]:
    colours = matplotlib.colormaps["viridis"](np.clip(parts, 0.0, 1.0))
    return (255 * np.asarray(colours)[:, :3]).astype(np.uint8)


def _blueprint() -> rrb.Blueprint:
    blocks = scene_view(
        "scene", "Blocks, hulls, ratings and camera", (0.35, -0.45, 0.35), (0.0, 0.0, 0.04)
    )
    sphere = scene_view(
        "sphere", "Target field visibility, hidden parts dark", (0.05, -0.1, 0.42), (0.0, 0.0, 0.03)
    )
    camera = rrb.Spatial2DView(origin="scene/camera", name="What the camera sees")
    return side_by_side(blocks, rrb.Vertical(camera, sphere))
