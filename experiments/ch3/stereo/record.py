"""A stereo mapping run as a recording for the rerun viewer: the map grows view by view."""

from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import StereoView
from experiments.ch3.stereo.trial import MappingTrial, map_scene
from experiments.harness.recording import RunFiles, recording, viridis
from perception.voxels.map import VoxelMap
from twin.recording.layout import scene_view, side_by_side

_SHOWN = 40_000
"""Greatest number of points of the map that are written at each view, drawn at random."""
_QUALITY = 60


def record_map(trial: MappingTrial, files: RunFiles) -> VoxelMap:
    """Map a scene and write it: points by probability, cameras, candidates, images and curves.

    Args:
        trial: Scene and method.
        files: What to write.

    Returns:
        The map.
    """
    if not files.recording:
        return map_scene(trial, files=files).mapper.shared.voxels
    rng = np.random.default_rng(0)
    with recording(Path(files.recording), _blueprint()) as stream:
        stream.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

        def take(mapper: StereoMapper, view: StereoView, share: float) -> None:
            stream.reset_time()
            stream.set_time("sim_time", duration=view.time)
            stream.set_time("step", sequence=len(mapper.views))
            _log_map(stream, mapper, rng)
            _log_camera(stream, mapper, view)
            _log_candidates(stream, view)
            cells, _ = mapper.shared.voxels.occupied_cells()
            fiducials = len(mapper.localizer.fiducials)
            for name, value in (("share", share), ("points", len(cells)), ("fiducials", fiducials)):
                stream.log(f"curves/{name}", rr.Scalars(value))

        return map_scene(trial, take, files).mapper.shared.voxels


def _log_map(stream: rr.RecordingStream, mapper: StereoMapper, rng: np.random.Generator) -> None:
    surface = mapper.shared.voxels.surface()
    count = len(surface.means)
    chosen = rng.choice(count, min(count, _SHOWN), replace=False)
    colours = _colours(surface.probabilities[chosen], 0.5, 1.0)
    points = surface.means[chosen].astype(np.float32)
    stream.log("map/surface", rr.Points3D(points, colors=colours, radii=0.003))
    fiducials = mapper.localizer.fiducials.positions.astype(np.float32)
    stream.log("map/fiducials", rr.Points3D(fiducials, colors=[255, 140, 0], radii=0.008))


def _log_camera(stream: rr.RecordingStream, mapper: StereoMapper, view: StereoView) -> None:
    quality = [int(cv2.IMWRITE_JPEG_QUALITY), _QUALITY]
    _, data = cv2.imencode(".jpg", view.pair[0], quality)
    image = rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")
    stream.log(f"images/{view.robot}", image)
    if view.correction is None:
        return
    for name, pixels, colour in (
        ("found", view.correction.found, (255, 140, 0)),
        ("new", view.correction.added, (0, 200, 220)),
    ):
        marks = rr.Points2D(pixels[:, :2], colors=[colour], radii=4.0)
        stream.log(f"images/{view.robot}/{name}", marks)
    pose = view.correction.camera.transform_camera_to_world
    placed = rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation.as_matrix())
    stream.log(f"map/{view.robot}", placed)
    g = mapper.shared.geometry
    size = [g.width, g.height]
    lens = rr.Pinhole(image_from_camera=g.matrix, resolution=size, image_plane_distance=0.15)
    stream.log(f"map/{view.robot}", lens)


def _log_candidates(stream: rr.RecordingStream, view: StereoView) -> None:
    if view.rated is None:
        return
    places = view.rated.cameras.translation.astype(np.float32)
    colours = _colours(view.rated.ratings, view.rated.ratings.min(), view.rated.ratings.max())
    stream.log(f"map/candidates/{view.robot}", rr.Points3D(places, colors=colours, radii=0.006))


def _colours(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Return (N, 3) colours from dark to bright."""
    return viridis((values - low) / max(high - low, 1e-9))


def _blueprint() -> rrb.Blueprint:
    images = [
        rrb.Spatial2DView(origin=f"images/{name}", name=f"{name}, left eye")
        for name in ("rover1", "rover2")
    ]
    return side_by_side(
        scene_view("map", "Map, cameras and candidates", (1.6, -2.6, 1.9), (0.0, -0.4, 0.0)),
        rrb.Vertical(
            *images,
            rrb.TimeSeriesView(origin="curves/share", name="Share of the surface mapped"),
            rrb.TimeSeriesView(origin="curves/points", name="Mapped points"),
            row_shares=[3, 3, 2, 2],
        ),
    )
