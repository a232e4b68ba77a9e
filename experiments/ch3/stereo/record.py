"""A stereo mapping run as a recording for the rerun viewer: the map grows view by view."""

from pathlib import Path
from types import TracebackType

import cv2
import matplotlib
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import StereoView
from twin.layout import scene_view, side_by_side

_SHOWN = 40_000
"""Points of the map that are written at each view, at most: drawn at random."""
_QUALITY = 60


class MapRecorder:
    """Writes views to a file: points by probability, cameras, candidates, images and curves."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Args:
            path: File to write, ``.rrd``.
        """
        self._stream = rr.RecordingStream("fieldtwin")
        self._stream.save(path)
        self._stream.send_blueprint(_blueprint())
        self._stream.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._rng = np.random.default_rng(0)
        self._count = 0

    def __enter__(self) -> "MapRecorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def take(self, mapper: StereoMapper, view: StereoView, share: float) -> None:
        """Take one view.

        Args:
            mapper: With the map after it.
            view: The view.
            share: Share of the true surface that is mapped by now.
        """
        self._count += 1
        self._stream.reset_time()
        self._stream.set_time("sim_time", duration=view.time)
        self._stream.set_time("step", sequence=self._count)
        self._map(mapper)
        self._camera(mapper, view)
        self._candidates(view)
        self._stream.log("curves/share", rr.Scalars(share))
        cells, _ = mapper.shared.voxels.occupied_cells()
        self._stream.log("curves/points", rr.Scalars(len(cells)))
        self._stream.log("curves/fiducials", rr.Scalars(len(mapper.localizer.fiducials)))

    def _map(self, mapper: StereoMapper) -> None:
        surface = mapper.shared.voxels.surface()
        count = len(surface.means)
        chosen = self._rng.choice(count, min(count, _SHOWN), replace=False)
        colours = _colours(surface.probabilities[chosen], 0.5, 1.0)
        points = surface.means[chosen].astype(np.float32)
        self._stream.log("map/surface", rr.Points3D(points, colors=colours, radii=0.003))
        fiducials = mapper.localizer.fiducials.positions.astype(np.float32)
        marks = rr.Points3D(fiducials, colors=[255, 140, 0], radii=0.008)
        self._stream.log("map/fiducials", marks)

    def _camera(self, mapper: StereoMapper, view: StereoView) -> None:
        quality = [int(cv2.IMWRITE_JPEG_QUALITY), _QUALITY]
        _, data = cv2.imencode(".jpg", view.pair[0], quality)
        image = rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")
        self._stream.log(f"images/{view.robot}", image)
        if view.correction is None:
            return
        for name, pixels, colour in (
            ("found", view.correction.found, (255, 140, 0)),
            ("new", view.correction.added, (0, 200, 220)),
        ):
            marks = rr.Points2D(pixels[:, :2], colors=[colour], radii=4.0)
            self._stream.log(f"images/{view.robot}/{name}", marks)
        pose = view.correction.camera.transform_camera_to_world
        path = f"map/{view.robot}"
        placed = rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation.as_matrix())
        self._stream.log(path, placed)
        g = mapper.shared.geometry
        lens = rr.Pinhole(
            image_from_camera=g.matrix,
            resolution=[g.width, g.height],
            image_plane_distance=0.15,
        )
        self._stream.log(path, lens)

    def _candidates(self, view: StereoView) -> None:
        if view.rated is None:
            return
        places = view.rated.cameras.translation.astype(np.float32)
        colours = _colours(view.rated.ratings, view.rated.ratings.min(), view.rated.ratings.max())
        dots = rr.Points3D(places, colors=colours, radii=0.006)
        self._stream.log(f"map/candidates/{view.robot}", dots)


def _colours(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Return (N, 3) colours from dark to bright."""
    part = (values - low) / max(high - low, 1e-9)
    colours = matplotlib.colormaps["viridis"](np.clip(part, 0.0, 1.0))
    return (255 * np.asarray(colours)[:, :3]).astype(np.uint8)


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
