"""A camera placement in space as a recording for the rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from controllers.placement.spatial.best_first import direction_tree
from controllers.placement.spatial.field import signed_caps
from controllers.placement.spatial.occluders import TargetField
from controllers.placement.task import View
from experiments.ch4.spatial.figures import hull_edges
from experiments.harness.recording import closed, recording, viridis
from models.blocks import Block, camera_axes
from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray
from twin.recording.layout import scene_view, side_by_side

_QUALITY = 80


def record_placement(
    path: Path, field: TargetField, blocks: Sequence[Block],
    cloud: tuple[FloatArray, FloatArray], views: Sequence[View],
    images: Sequence[NDArray[np.uint8]], aim: FloatArray,
) -> None:  # fmt: skip
    """Write the scene, the hulls, the sphere projection, the rated poses and the chosen view.

    Args:
        path: File to write, ``.rrd``.
        field: Target with its expanded hulls.
        blocks: Blocks as the planner estimates them.
        cloud: (N, 3) positions [m], world, and (N,) their ratings.
        views: Views, the chosen one first; each is a step of the recording, in reverse order.
        images: (height, width, 3) picture of each view.
        aim: (3,) point that the cameras look at [m], world.
    """
    with recording(path, _blueprint()) as stream:
        _log_scene(stream, field, blocks, cloud)
        _log_sphere(stream, field, views[0].distance)
        # The chosen view comes last, where the viewer opens a recording.
        for step, (view, image) in enumerate(list(zip(views, images))[::-1]):
            stream.reset_time()
            stream.set_time("sim_time", duration=float(step))
            stream.set_time("step", sequence=step)
            _log_camera(stream, view, image, aim)


def _log_scene(
    stream: rr.RecordingStream, field: TargetField, blocks: Sequence[Block],
    cloud: tuple[FloatArray, FloatArray],
) -> None:  # fmt: skip
    """Log the blocks, the expanded hulls, the target and the ratings of positions."""
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    boxes = rr.Boxes3D(
        centers=[block.centre for block in blocks],
        half_sizes=[block.half for block in blocks],
        rotation_axis_angles=[rr.RotationAxisAngle([0, 0, 1], block.yaw) for block in blocks],
        labels=[block.name for block in blocks], show_labels=False,
        colors=[190, 150, 110], fill_mode="solid",
    )  # fmt: skip
    stream.log("scene/blocks", boxes, static=True)
    for name, shape in zip(field.names, field.shapes):
        lines = rr.LineStrips3D(hull_edges(shape), colors=[90, 140, 220], radii=0.0003)
        stream.log(f"scene/hulls/{name}", lines, static=True)
    rim = closed(field.target.position + field.target.outline)
    stream.log(
        "scene/target", rr.LineStrips3D([rim], colors=[255, 60, 60], radii=0.0006), static=True
    )
    places, ratings = cloud
    good = ratings > 0.0
    colours = viridis(ratings[good] / ratings.max())
    dots = rr.Points3D(places[good], colors=colours, radii=0.0015)
    stream.log("scene/ratings", dots, static=True)


def _log_sphere(stream: rr.RecordingStream, field: TargetField, radius: float) -> None:
    """Log the sphere of the chosen distance: the free cap as colour, hidden parts dark."""
    places = field.to_world(radius * direction_tree(5).leaves)
    caps = signed_caps(field, places) / (0.5 * np.pi)
    colours = np.where(caps[:, None] > 0.0, viridis(caps), np.array([40, 40, 40], np.uint8))
    stream.log("sphere", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("sphere/free_cap", rr.Points3D(places, colors=colours, radii=0.0016), static=True)


def _log_camera(
    stream: rr.RecordingStream, view: View, image: NDArray[np.uint8], aim: FloatArray
) -> None:
    # The picture's rows go down and its depth ahead.
    turn = camera_axes(view.position, aim) * [1.0, -1.0, -1.0]
    stream.log("scene/camera", rr.Transform3D(translation=view.position, mat3x3=turn))
    lens = rr.Pinhole(
        image_from_camera=CAMERA.pinhole.matrix,
        resolution=[CAMERA.width, CAMERA.height],
        image_plane_distance=0.06,
    )
    stream.log("scene/camera", lens)
    stream.log("scene/camera/image", rr.Image(image).compress(_QUALITY))
    for name, value in (("rating", view.rating), ("free_cap_deg", np.rad2deg(view.free_cap))):
        stream.log(f"curves/{name}", rr.Scalars(float(value)))


def _blueprint() -> rrb.Blueprint:
    blocks = scene_view(
        "scene", "Blocks, hulls, ratings and camera", (0.35, -0.45, 0.35), (0.0, 0.0, 0.04)
    )
    sphere = scene_view(
        "sphere", "Target field visibility, hidden parts dark", (0.05, -0.1, 0.42), (0.0, 0.0, 0.03)
    )
    camera = rrb.Spatial2DView(origin="scene/camera", name="What the camera sees")
    return side_by_side(blocks, rrb.Vertical(camera, sphere))
