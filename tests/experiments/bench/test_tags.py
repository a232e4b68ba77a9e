"""Tags: found where a homography puts them, and made into poses as sure as they say."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from experiments.bench.tags import (
    FAMILIES,
    SQUARE,
    find_tags,
    fit_tags,
    numbers,
    single_image_pose,
)
from experiments.ch3.stereo.scene import HEAD
from experiments.ch5.marker_scene import marker_cads
from models.datasheets import CARD_AND_SLOT

CARD, SLOT = marker_cads(CARD_AND_SLOT.slot_widths[1])


def drawn(family, number, homography, size=(200, 220), samples=6):
    """OpenCV's picture of a tag under a homography from cells to pixels, integrated by samples."""
    dictionary = cv2.aruco.getPredefinedDictionary(family.dictionary)
    cells = cv2.aruco.generateImageMarker(dictionary, number, family.cells)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    rows = (np.arange(size[0])[:, None] + offsets).ravel()
    columns = (np.arange(size[1])[:, None] + offsets).ravel()
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 1, 2)
    place = np.floor(cv2.perspectiveTransform(grid, np.linalg.inv(homography))[:, 0]).astype(int)
    inside = ((place >= 0) & (place < family.cells)).all(axis=1)
    margin = ((place >= -1) & (place < family.cells + 1)).all(axis=1)
    grey = np.where(margin, 230.0, 90.0)
    grey[inside] = np.where(cells[place[inside, 1], place[inside, 0]] > 0, 230.0, 20.0)
    image = grey.reshape(size[0], samples, size[1], samples).mean(axis=(1, 3))
    return np.rint(image).astype(np.uint8)


@pytest.mark.parametrize("name", FAMILIES)
def test_tags_of_opencvs_are_found_to_a_tenth_of_a_pixel(name):
    family, errors = FAMILIES[name], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * family.cells
        target = [[70.3, 60.8], [121.4, 66.1], [117.2, 131.7], [65.9, 118.2]]
        target = target + rng.uniform(-5, 5, 2) + rng.uniform(-4, 4, (4, 2))
        homography = cv2.getPerspectiveTransform(np.float32(square), np.float32(target))
        found = find_tags(drawn(family, 2, homography), family)
        assert list(found) == [2]
        true = cv2.perspectiveTransform(square[:, None].astype(float), homography)[:, 0]
        errors.append(found[2] - true)
    # OpenCV's lines through the edges leave single corners a quarter of a pixel off.
    assert np.median(np.linalg.norm(errors, axis=2)) < 0.1
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.05
    assert np.abs(errors).max() < 0.4


def test_a_tag_that_is_twice_in_the_image_is_not_used():
    family = FAMILIES["aruco"]
    scale = np.diag([6.0, 7.0, 1.0])
    scale[:2, 2] = 40.0
    image = drawn(family, 1, scale)
    assert list(find_tags(image, family)) == [1]
    assert find_tags(np.hstack([image, image]), family) == {}


@pytest.mark.parametrize("name", FAMILIES)
def test_tags_lie_in_the_square_that_a_disc_has_to_itself(name):
    family = FAMILIES[name]
    for cad, edges in ((CARD, 0.5 * CARD_AND_SLOT.card_width), (SLOT, None)):
        for centre in cad.points:
            corners = family.corners(centre)
            assert corners.mean(axis=0) == pytest.approx(centre)
            cell = np.linalg.norm(corners[1] - corners[0]) / family.cells
            assert cell * (family.cells + 2) == pytest.approx(SQUARE)
            if edges is not None:
                assert abs(centre[0]) + SQUARE / 2.0 < edges
    # Discs are in the middle of the walls' faces, which are wider.
    assert SQUARE < CARD_AND_SLOT.wall
    assert family.pattern(0)[[0, -1]].all() and not family.pattern(0)[[1, -2], 1:-1].any()


def body_pose(rng):
    turn = Rotation.from_rotvec(rng.uniform(-0.7, 0.7, 3)) * Rotation.from_rotvec([np.pi, 0, 0])
    return RigidTransform.from_components([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.7)],
                                          turn)  # fmt: skip


def known_corners(cad):
    return {
        number: FAMILIES["aruco"].corners(centre)
        for number, centre in zip(numbers(0, cad), cad.points, strict=True)
    }


def seen_corners(pose, known, sigma, rng):
    """Corners in both images by the pinhole, with noise."""
    return [
        {
            number: HEAD.pixels(pose.apply(points) - [eye * HEAD.baseline, 0.0, 0.0])
            + rng.normal(0.0, sigma, (4, 2))
            for number, points in known.items()
        }
        for eye in (0, 1)
    ]


def test_exact_corners_give_the_pose_from_a_pair_and_from_one_image():
    rng, known = np.random.default_rng(0), known_corners(CARD)
    for _ in range(5):
        pose = body_pose(rng)
        seen = seen_corners(pose, known, 0.0, rng)
        for found in (fit_tags(seen, known, HEAD, 0.1).transform_body_to_camera,
                      single_image_pose(seen[0], known, HEAD)):  # fmt: skip
            assert (pose * found.inv()).as_exp_coords() == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("tags", [1, 2])
def test_pose_error_is_consistent_with_its_covariance(tags):
    rng, sigma = np.random.default_rng(1), 0.1
    known = dict(list(known_corners(CARD).items())[:tags])
    errors = []
    for _ in range(150):
        pose = body_pose(rng)
        fit = fit_tags(seen_corners(pose, known, sigma, rng), known, HEAD, sigma)
        xi = (pose * fit.transform_body_to_camera.inv()).as_exp_coords()
        errors.append(xi @ np.linalg.solve(fit.covariance, xi) / 6.0)
    # The scale is itself an estimate with 24 degrees of freedom or more: a mean of up to 9/8,
    # and a deviation of a mean of 150 of 0.06.
    assert 0.8 < np.mean(errors) < 1.35


def test_corners_worse_than_stated_make_the_pose_less_sure():
    known = known_corners(CARD)
    pose = body_pose(np.random.default_rng(2))
    sure, unsure = (
        np.mean(
            [
                np.trace(
                    fit_tags(
                        seen_corners(pose, known, sigma, np.random.default_rng(seed)),
                        known, HEAD, 0.1,
                    ).covariance
                )
                for seed in range(20)
            ]
        )
        for sigma in (0.1, 0.5)
    )  # fmt: skip
    # 26 degrees of freedom are the residuals', which are 25 times as large; 8 are not.
    assert unsure / sure == pytest.approx((26 * 25 + 8) / (26 + 8), rel=0.2)


def test_tags_of_one_image_alone_or_of_other_rows_are_left_out():
    rng, known = np.random.default_rng(4), known_corners(CARD)
    pose = body_pose(rng)
    left, right = seen_corners(pose, known, 0.05, rng)
    one = fit_tags([left, {1: right[1]}], known, HEAD, 0.1)
    both = fit_tags([left, {**right, 0: right[0] + [0.0, 20.0]}], known, HEAD, 0.1)
    assert both.covariance == pytest.approx(one.covariance)
    assert fit_tags([left, {}], known, HEAD, 0.1) is None
    assert fit_tags([{0: left[0]}, {1: right[1]}], known, HEAD, 0.1) is None
