"""Errors of stereo heads as made, and the sets by name."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mapping.shared_map import SharedMap
from models.clutter import PanelConfig
from models.datasheets import CAMERA, LENS
from perception.registration.target import SeenTarget, TargetCad
from perception.stereo.geometry import StereoGeometry
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from twin.optics.realism import CAMERA_SETS, DEFAULT_CAMERA, IDEAL_CAMERA, CameraRealism, MadeHead

LEFT = RigidTransform.from_components([1.0, 2.0, 0.5], Rotation.from_euler("xyz", [1.0, 0.4, 0.2]))
RIGHT = LEFT * RigidTransform.from_translation([CAMERA.baseline, 0.0, 0.0])


def test_errors_have_the_stated_deviations():
    realism = DEFAULT_CAMERA
    heads = [MadeHead.draw(realism, np.random.default_rng((1, seed))) for seed in range(400)]
    heads_at = np.array([head.head.as_exp_coords() for head in heads])
    eyes_at = np.array([eye.as_exp_coords() for head in heads for eye in head.eyes])
    for values, sigma in (
        ([head.focal - 1.0 for head in heads], realism.focal_error),
        ([head.principal for head in heads], realism.principal_error),
        ([np.log(head.gain) for head in heads], realism.gain_error),
        (heads_at[:, :3], realism.head_turn),
        (heads_at[:, 3:], realism.head_shift),
        (eyes_at[:, :3], realism.eye_turn),
        (eyes_at[:, 3:], realism.eye_shift),
    ):
        spread = np.sqrt(np.mean(np.square(values), axis=0)) / sigma
        # Five deviations of the estimate from 400.
        np.testing.assert_allclose(spread, 1.0, atol=5.0 / np.sqrt(2.0 * 400))


def test_ideal_head_is_as_drawn():
    made = MadeHead.draw(IDEAL_CAMERA, np.random.default_rng(1))
    assert made.lens(CAMERA.pinhole) == CAMERA.pinhole and made.gain == 1.0
    for found, drawn in zip(made.poses((LEFT, RIGHT)), (LEFT, RIGHT), strict=True):
        np.testing.assert_allclose(found.as_matrix(), drawn.as_matrix(), atol=1e-12)


def test_head_turns_about_the_middle_between_its_eyes():
    realism = CameraRealism(head_turn=0.1, head_shift=0.02)
    made = MadeHead.draw(realism, np.random.default_rng(2))
    left, right = made.poses((LEFT, RIGHT))
    middle = 0.5 * (LEFT.translation + RIGHT.translation)
    shift = LEFT.rotation.apply(made.head.translation)
    np.testing.assert_allclose(0.5 * (left.translation + right.translation), middle + shift)
    turn = LEFT.rotation.inv() * left.rotation
    np.testing.assert_allclose(turn.as_matrix(), made.head.rotation.as_matrix(), atol=1e-12)
    across = left.rotation.inv().apply(right.translation - left.translation)
    np.testing.assert_allclose(across, [CAMERA.baseline, 0.0, 0.0], atol=1e-12)


def test_eyes_turn_and_shift_against_each_other():
    made = MadeHead.draw(CameraRealism(eye_turn=0.01, eye_shift=1e-3), np.random.default_rng(2))
    left, right = made.poses((LEFT, RIGHT))
    for found, drawn, error in ((left, LEFT, made.eyes[0]), (right, RIGHT, made.eyes[1])):
        np.testing.assert_allclose((drawn.inv() * found).as_matrix(), error.as_matrix(), atol=1e-12)
    assert not np.allclose(made.eyes[0].as_matrix(), made.eyes[1].as_matrix())


def test_focus_is_the_hyperfocal_distance_of_one_pixel():
    """Seen from a lens in focus there, infinity and half the distance are a pixel wide."""
    aperture, focus = CAMERA.focal_length / LENS.f_number, LENS.focus_distance
    sensor = 1.0 / (1.0 / CAMERA.focal_length - 1.0 / focus)
    blur = aperture * (sensor - CAMERA.focal_length) / CAMERA.focal_length
    assert blur == pytest.approx(CAMERA.sensing_width / CAMERA.width, rel=1e-9)


def test_every_set_lasts_longer_than_its_exposure_and_read_out():
    assert list(CAMERA_SETS) == ["ideal", "default", "harsh"]
    for name in ("default", "harsh"):
        realism = CAMERA_SETS[name]
        assert realism.latency > 0.5 * realism.exposure + CAMERA.frame_time
    sizes = [dataclasses.asdict(CAMERA_SETS[name]) for name in ("default", "harsh")]
    for key in (*(key for key in sizes[0] if key.endswith(("error", "turn", "shift"))), "exposure"):
        assert 0.0 < sizes[0][key] < sizes[1][key], key


@pytest.mark.parametrize(
    "changes",
    [
        {"exposure": -0.01},
        {"exposure": 0.02, "latency": 0.005},
        {"f_number": 0.0},
        {"focus_distance": 0.005},
        {"vignetting": 1.0},
        {"head_turn": float("nan")},
        {"gain_error": float("inf")},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_impossible_camera_is_refused_by_name(changes):
    with pytest.raises(ValueError, match=f"camera .*{'latency' if len(changes) > 1 else ''}"):
        CameraRealism(**changes)


def test_points_through_drawn_heads_scatter_as_the_stated_calibration_says():
    """By its jacobian, which the markers' fits use; all points of a head move together."""
    realism = dataclasses.replace(DEFAULT_CAMERA, head_turn=0.0, head_shift=0.0)
    geometry = StereoGeometry(*CAMERA.pinhole.intrinsics, CAMERA.baseline, realism.calibration)
    points = np.array([[0.02, -0.1, 0.35], [-0.08, 0.05, 0.6]])
    columns, rows, disparities = geometry.project(points).T
    drawn = np.stack([columns, rows, columns - disparities, rows], axis=-1)
    seen = []
    for seed in range(4000):
        made = MadeHead.draw(realism, np.random.default_rng((5, seed)))
        lens = made.lens(CAMERA.pinhole)
        left, right = made.poses((LEFT, RIGHT))
        seen.append(
            np.hstack([lens.pixels(points), lens.pixels((right.inv() * left).apply(points))])
        )
    errors = (np.array(seen) - drawn).reshape(len(seen), -1)
    jacobian = geometry.calibration_jacobian(points).reshape(8, -1)
    stated, found = jacobian @ jacobian.T, np.cov(errors.T)
    deviations = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(
        found / np.outer(deviations, deviations),
        stated / np.outer(deviations, deviations),
        atol=5.0 * np.sqrt(2.0 / len(seen)),
    )
    # Rows of the two eyes differ by what the datasheet's words say: some tenths of a pixel.
    assert 0.1 < np.std(errors[:, 1] - errors[:, 3]) < 0.3


def test_head_that_is_its_drawing_moves_no_point():
    geometry = StereoGeometry(*CAMERA.pinhole.intrinsics, CAMERA.baseline, IDEAL_CAMERA.calibration)
    assert not geometry.calibration_jacobian([0.1, 0.1, 0.5]).any()


def test_points_triangulated_through_drawn_heads_scatter_as_the_stated_calibration_says():
    realism = dataclasses.replace(DEFAULT_CAMERA, head_turn=0.0, head_shift=0.0)
    geometry = StereoGeometry(*CAMERA.pinhole.intrinsics, CAMERA.baseline, realism.calibration)
    points = np.array([[0.02, -0.1, 0.35], [-0.08, 0.05, 0.6]])
    found = np.array(
        [geometry.points(_image_points(realism, points, seed)) for seed in range(4000)]
    )
    shifts = geometry.calibration_shifts(points).reshape(6, -1)
    stated, drawn = shifts @ shifts.T, np.cov(found.reshape(len(found), -1).T)
    deviations = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(
        drawn / np.outer(deviations, deviations),
        stated / np.outer(deviations, deviations),
        atol=5.0 * np.sqrt(2.0 / len(found)),
    )


def test_target_is_found_by_a_head_as_made_and_its_pose_errs_as_stated():
    """Against drawn heads: 200 of them see the panel from 0.9 m, with noise of a marker's."""
    panel = PanelConfig((0.0, 0.0))
    cad = TargetCad(panel.marker_points, panel.markers[0].radius, panel.markers[0].dark)
    geometry = StereoGeometry(
        *CAMERA.pinhole.intrinsics, CAMERA.baseline, DEFAULT_CAMERA.calibration
    )
    shared = SharedMap(VoxelMap(VoxelGrid(0.1, (0, 0, 0), (1, 1, 1))), geometry, cad, 4, (0.2, 2.0))
    to_camera = RigidTransform.from_components(
        [0.05, -0.02, 0.9], Rotation.from_euler("xyz", [2.7, 0.3, 0.1])
    )
    rng, sigma = np.random.default_rng(8), np.array([0.07, 0.07, 0.03])
    squared = []
    for seed in range(200):
        seen = _image_points(DEFAULT_CAMERA, to_camera.apply(cad.points), seed)
        seen += sigma * rng.standard_normal(seen.shape)
        camera = shared.camera_at(SeenTarget(np.arange(len(seen)), seen), sigma)
        if camera is not None:
            xi = (to_camera.inv() * camera.transform_camera_to_world.inv()).as_exp_coords()
            squared.append(float(xi @ np.linalg.solve(camera.covariance, xi)) / 6.0)
    assert len(squared) >= 198
    assert 0.8 < np.mean(squared) < 1.25


def _image_points(realism, points, seed):
    """Return columns and rows of the left image, and disparities, through a head as made."""
    made = MadeHead.draw(realism, np.random.default_rng((6, seed)))
    lens = made.lens(CAMERA.pinhole)
    left, right = made.poses((LEFT, RIGHT))
    # The frame is that of the left eye as made.
    seen, other = lens.pixels(points), lens.pixels((right.inv() * left).apply(points))
    return np.column_stack([seen, seen[:, 0] - other[:, 0]])
