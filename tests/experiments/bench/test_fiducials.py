"""The sweep of circles and tags: its poses, its scores, and a clean near pair."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from experiments.bench.fiducials import (
    HIGHEST,
    LOWEST,
    METHODS,
    OURS,
    POSES,
    FiducialScene,
    draw_errors,
    sweep_poses,
)
from experiments.bench.image_conditions import CLEAN, CONDITIONS, take
from experiments.bench.tags import FAMILIES, BodyPose, paint_tags
from experiments.ch3.stereo.scene import HEAD
from experiments.ch5.marker_scene import MarkerScene, marker_cads
from models.datasheets import CARD_AND_SLOT


@functools.cache
def scene():
    return FiducialScene(0)


def test_sweep_fills_its_ranges_evenly_and_keeps_all_tags_in_both_images():
    poses = sweep_poses(POSES, 5)
    distances = np.array([pose.distance for pose in poses])
    counts, _ = np.histogram(distances, 16, (LOWEST["range"], HIGHEST["range"]))
    assert (counts == POSES // 16).all()
    slants = []
    for pose in poses:
        scene().place(pose)
        assert scene().truth()[1].translation == pytest.approx(pose.slot.translation)
        for body, truth in enumerate(scene().truth()):
            score = scene().score((OURS, CLEAN.name), body, pose.distance, None)
            slants.append(score.slant)
            assert np.isnan(score.error_mm)
            for name, family in FAMILIES.items():
                for corners in scene().corners[name][body].values():
                    seen = truth.apply(corners)
                    for eye in (0.0, HEAD.baseline):
                        pixels = HEAD.pixels(seen - [eye, 0.0, 0.0])
                        assert (pixels > 2.0).all()
                        assert (pixels < [HEAD.width - 3.0, HEAD.height - 3.0]).all()
                    # Seen from the front.
                    assert truth.rotation.apply([0.0, 0.0, 1.0]) @ seen.mean(axis=0) < 0.0
                    assert family.cells in (6, 8)
    # Slants of a body differ from those of both by what it is beside the middle.
    assert np.percentile(slants, [25, 50, 75]) == pytest.approx([15.0, 30.0, 45.0], abs=4.0)


def test_scores_are_consistent_with_errors_drawn_from_their_covariance():
    rng = np.random.default_rng(2)
    scene().place(sweep_poses(1, 3)[0])
    root = np.diag([0.01, 0.02, 0.005, 1e-4, 3e-4, 1e-3]) @ np.linalg.qr(rng.normal(size=(6, 6)))[0]
    errors = []
    for _ in range(400):
        error = RigidTransform.from_exp_coords(root @ rng.standard_normal(6))
        found = BodyPose(error.inv() * scene().truth()[0], root @ root.T)
        errors.append(scene().score((OURS, CLEAN.name), 0, 0.5, found).nees)
    # Chi-squared with 6 degrees over 6: variance 1/3.
    assert np.mean(errors) == pytest.approx(1.0, abs=4.0 * np.sqrt(1.0 / 3.0 / 400))
    assert np.var(errors) == pytest.approx(1.0 / 3.0, rel=0.6)


def test_scores_of_a_known_error():
    scene().place(sweep_poses(1, 3)[0])
    truth = scene().truth()[1]
    middle = truth.apply(marker_cads(CARD_AND_SLOT.slot_widths[1])[1].points.mean(axis=0))
    about = RigidTransform.from_translation(middle)
    turned = about * RigidTransform.from_exp_coords([0.0, 0.02, 0.0, 0, 0, 0]) * about.inv()
    found = BodyPose(RigidTransform.from_translation([0, 3e-3, 4e-3]) * turned * truth, np.eye(6))
    score = scene().score((OURS, CLEAN.name), 1, 0.5, found)
    assert score.error_mm == pytest.approx(5.0)
    assert score.error_deg == pytest.approx(np.degrees(0.02))
    figure = draw_errors([score, score._replace(method="aruco", error_mm=np.nan)])
    assert len(figure.axes) == 2


@pytest.mark.slow
def test_all_methods_find_card_and_slot_in_a_clean_near_pair():
    pose = next(p for p in sweep_poses(POSES, 5) if p.distance < 0.5)
    exact = scene().exact_pairs(pose)
    for method in METHODS:
        pair = take(exact[method], CLEAN, 0.0, np.random.default_rng(0))
        if method == OURS:
            (found,) = scene().circle_poses(pair, pose.distance, CLEAN)
        else:
            found, single = scene().tag_poses(method, pair)
            assert None not in single
        for body, fit in enumerate(found):
            score = scene().score((method, CLEAN.name), body, pose.distance, fit)
            assert score.error_mm < 1.0 and score.error_deg < 2.0


@pytest.mark.slow
def test_texture_is_fine_enough_and_no_paint_shows_through_another():
    cads = marker_cads(CARD_AND_SLOT.slot_widths[1])
    pose = sweep_poses(4, 5)[0]
    pairs = []
    for texels in (64, 128):
        bare = MarkerScene(
            np.random.default_rng(0), None, functools.partial(paint_tags, cads=cads, texels=texels)
        )
        camera = RigidTransform.from_translation([0.0, 0.0, 0.4])
        bare.place(camera, camera * RigidTransform.from_translation([0.0, -0.0175, 0.0]),
                   camera * pose.slot.inv())  # fmt: skip
        bare.wear("aruco")
        pairs.append(bare.exact_pair(3))
        bare.wear("none")
        plain = bare.exact_pair(3)
        bare.wear("discs")
        discs = bare.exact_pair(3)
    assert np.abs(pairs[0] - pairs[1]).max() < 2.0
    # Discs change bright pixels only where they are; nothing of the tags is left.
    assert (discs - plain).min() > -1.0
    assert 50 < (np.abs(discs - plain) > 3.0).sum() < (np.abs(pairs[1] - plain) > 3.0).sum()


def test_conditions_change_one_thing_each():
    for condition in CONDITIONS:
        changed = {
            field.name
            for field in dataclasses.fields(condition)
            if getattr(condition, field.name) != getattr(CLEAN, field.name)
        } - {"name", "gamma", "linearised"}
        assert len(changed) == (condition is not CLEAN)
