"""When views are fused and reported, before and after a robot has detected the target."""

import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm, stereo_geometry
from controllers.mapping import stereo_mapper
from controllers.mapping.fiducial_localizer import Correction, FiducialLocalizer
from controllers.mapping.localization import CameraPose, RobotLocalization
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import MapperConfig, StereoView
from perception.registration.fiducial_map import PosePrior
from perception.registration.target import PossibleMarkers
from perception.stereo.matching import StereoMatcher
from tests.controllers.mission.hand_made import (
    MASTER,
    ROVERS,
    SITE,
    TILT,
    KinematicRover,
    transform_robot_to_ground,
)
from twin.robot import Command, Observation

ARM = camera_arm(ROVERS[MASTER])[0]
TO_WORLD = transform_robot_to_ground(MASTER)
FOUND = RobotLocalization(ARM, TO_WORLD, 1e-4 * np.eye(6), np.zeros((6, 10)))


class SharedViews:
    """Stands for a map in which the target is detected in one of the first views.

    Args:
        first: Index of the view that shows the target.

    Attributes:
        fused: Camera pose of each fused view.
    """

    def __init__(self, first: int) -> None:
        self.geometry, self.cad = stereo_geometry(ROVERS[MASTER]), SITE.target
        self.fused: list[RigidTransform] = []
        self._left = first

    def locate(self, *_: object) -> RobotLocalization | None:
        self._left -= 1
        return FOUND if self._left < 0 else None

    def fuse(self, camera: CameraPose, points: object, bodies: np.ndarray) -> None:
        self.fused.append(camera.transform_camera_to_world)

    def occupied_and_free(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(points), bool), np.ones(len(points), bool)


@pytest.fixture
def priors(monkeypatch: pytest.MonkeyPatch) -> list[PosePrior]:
    """Return a list that gets the prior of each corrected view; nothing is matched or detected."""
    priors: list[PosePrior] = []

    def locate(
        self: FiducialLocalizer, pair: object, points: object, prior: PosePrior
    ) -> Correction:
        priors.append(prior)
        # The shared offsets are known to the map of fiducials.
        assert len(self.fiducials.share(np.zeros((1, 1)))) == 1
        camera = CameraPose(prior.transform_camera_to_world, prior.covariance)
        return Correction(camera, np.zeros((0, 3)), np.zeros((0, 3)), False)

    nothing = PossibleMarkers(np.zeros((0, 3)), np.zeros((0, 3)))
    monkeypatch.setattr(StereoMatcher, "match", lambda self, pair: None)
    monkeypatch.setattr(stereo_mapper, "possible_markers", lambda *_: nothing)
    monkeypatch.setattr(FiducialLocalizer, "locate", locate)
    return priors


class Mapping:
    """A mapper as a stage of one robot."""

    def __init__(self, shared: SharedViews, known: bool) -> None:
        self.reported: list[tuple[int, StereoView]] = []
        localizations = {MASTER: FOUND} if known else None
        config = MapperConfig(method="raster", scans=4, search_scans=3)
        self.mapper = StereoMapper(
            {MASTER: ROVERS[MASTER]},
            typing.cast(typing.Any, shared),
            config,
            np.random.default_rng(0),
            lambda view: self.reported.append((len(shared.fused), view)),
            localizations,
        )

    def step(self, seen: Observation) -> Command:
        return self.mapper.step({MASTER: seen})[MASTER]


@pytest.mark.parametrize(("first", "known"), [(0, False), (2, False), (0, True)])
def test_views_are_fused_in_order_once_the_robot_is_localized(
    priors: list[PosePrior], first: int, known: bool
) -> None:
    shared = SharedViews(first)
    stage, rover = Mapping(shared, known), KinematicRover(MASTER)
    assert not stage.mapper.views
    while not stage.mapper.done and rover.ticks < 6000:
        rover.step(stage)
    mapper = stage.mapper
    assert mapper.done and len(mapper.views) == 4
    # Earlier views are fused together with the first in which the target is detected.
    assert [fused for fused, _ in stage.reported] == [0] * first + list(range(first + 1, 5))
    assert [view.number for _, view in stage.reported] == [0, 1, 2, 3]
    for number, (view, prior, fused) in enumerate(
        zip(mapper.views, priors, shared.fused, strict=True)
    ):
        assert view.robot == MASTER and view.number == number
        np.testing.assert_array_equal(view.tilt, TILT)
        expected = FOUND.camera(view.angles, TILT).transform_camera_to_world
        assert view.correction is not None and view.prediction is not None
        np.testing.assert_allclose(fused.as_matrix(), expected.as_matrix(), atol=1e-12)
        # All views share the errors of the robot's pose, its head and its joints.
        np.testing.assert_array_equal(prior.offsets, priors[0].offsets)
        assert len(prior.offsets) == 16


def test_search_ends_without_the_target_after_the_further_views(priors: list[PosePrior]) -> None:
    shared = SharedViews(100)
    stage, rover = Mapping(shared, known=False), KinematicRover(MASTER)
    while not stage.mapper.done and rover.ticks < 9000:
        rover.step(stage)
    assert len(stage.mapper.views) == 4 + 3 and not shared.fused and not priors
    assert not stage.mapper.localizations
