"""Exact sight agrees with a linear program and with dense rays; the hulls never see too much."""

import tracemalloc

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from controllers.placement.spatial.field import free_caps
from controllers.placement.spatial.occluders import expand
from controllers.placement.spatial.sight import sees_all
from controllers.placement.task import Occluder, PlacementError, Target
from tests.controllers.placement.spatial.scenes import box, disc_target, random_occluders


def meets(camera, target, occluder):
    """Whether two hulls share a point: weights of both that give the same one (HiGHS)."""
    ours = np.vstack([camera, target.position + target.outline])
    n, m = len(ours), len(occluder.points)
    equal = np.zeros((5, n + m))
    equal[:3, :n], equal[:3, n:] = ours.T, -occluder.points.T
    equal[3, :n], equal[4, n:] = 1.0, 1.0
    return linprog(np.zeros(n + m), A_eq=equal, b_eq=[0, 0, 0, 1, 1]).status == 0


def solid_target(rng):
    outline = rng.normal(scale=0.01, size=(6, 3))
    outline -= outline.mean(axis=0)
    normal = rng.normal(size=3)
    return Target("knob", rng.normal(size=3), normal / np.linalg.norm(normal), outline)


@pytest.mark.parametrize("kind", ["disc", "solid", "segment", "point"])
def test_sight_is_what_a_linear_program_finds(kind):
    rng = np.random.default_rng(sum(map(ord, kind)))
    hits = 0
    for _ in range(40):
        target = disc_target(position=rng.normal(size=3), normal=rng.normal(size=3))
        if kind == "solid":
            target = solid_target(rng)
        elif kind != "disc":
            count = 2 if kind == "segment" else 1
            outline = 0.01 * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])[:count] * (count - 1)
            target = Target(kind, target.position, target.normal, outline)
        occluder = random_occluders(rng, 1, target)[0]
        cameras = target.position + rng.normal(size=(8, 3)) * 0.3
        cameras[:4] = occluder.points.mean(axis=0) * 1.5 - target.position * 0.5
        cameras[:4] += rng.normal(scale=0.1, size=(4, 3))
        for camera, seen in zip(cameras, sees_all(target, [occluder], cameras)):
            if (camera - target.position) @ target.normal <= 0.0:
                assert not seen
                continue
            hidden = meets(camera, target, occluder)
            assert seen != hidden
            hits += hidden
    assert hits >= 3


def test_dense_rays_of_a_visible_target_are_all_clear():
    rng = np.random.default_rng(1)
    target = disc_target(radius=0.02)
    blocks = random_occluders(rng, 12, target)
    cameras = rng.uniform(-0.5, 0.5, (200, 3)) * [1, 1, 0.5] + [0, 0, 0.3]
    seen = sees_all(target, blocks, cameras)
    assert 20 < seen.sum() < 190
    weights = rng.dirichlet(0.3 * np.ones(len(target.outline)), 400)
    points = target.position + weights @ target.outline
    clear = np.ones(len(cameras), dtype=bool)
    for block in blocks:
        planes = ConvexHull(block.points).equations
        for index, camera in enumerate(cameras):
            start, end = (
                planes[:, :3] @ camera + planes[:, 3],
                points @ planes[:, :3].T + planes[:, 3],
            )
            with np.errstate(divide="ignore", invalid="ignore"):
                at = start / (start - end)
            enter = np.max(np.where(end < start, at, 0.0), axis=1)
            leave = np.min(np.where(end > start, at, 1.0), axis=1)
            outside = np.any((start > 0) & (end > 0), axis=1)
            clear[index] &= not np.any((enter <= leave) & ~outside)
    assert np.all(clear[seen])
    assert np.count_nonzero(clear & ~seen) <= 6  # Grazed between the rays.


def test_hulls_never_call_a_hidden_target_visible():
    rng = np.random.default_rng(2)
    cases = seen = truly = 0
    while cases < 4000:
        target = disc_target(position=rng.normal(size=3), normal=rng.normal(size=3))
        blocks = random_occluders(rng, int(rng.integers(3, 21)), target)
        cameras = target.position + 0.6 * rng.uniform(-1.0, 1.0, (100, 3))
        exact = sees_all(target, blocks, cameras)
        try:
            ours = free_caps(expand(target, blocks), cameras) > 0.0
        except PlacementError:
            continue
        assert not np.any(ours & ~exact)
        cases, seen, truly = cases + 100, seen + ours.sum(), truly + exact.sum()
    assert 0.7 * truly < seen <= truly


def test_box_just_beside_the_line_of_sight_hides_a_disc_but_not_its_middle():
    block = box("block", [0.0, 0.055, 0.1], [0.05, 0.05, 0.01])
    camera = [[0.0, 0.0, 0.2]]
    middle = Target("middle", np.zeros(3), np.array([0.0, 0.0, 1.0]), np.zeros((1, 3)))
    assert sees_all(middle, [block], camera)[0]
    assert sees_all(disc_target(radius=0.009), [block], camera)[0]
    assert not sees_all(disc_target(radius=0.011), [block], camera)[0]


def test_a_fine_mesh_takes_no_more_memory_than_its_corners():
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = Occluder("ball", np.array([0.0, 0.0, 0.2]) + 0.05 * directions)
    tracemalloc.start()
    found = sees_all(disc_target(), [ball], [[0.0, 0.0, 0.4], [0.3, 0.0, 0.1]])
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.tolist() == [False, True]
    assert most < 200 * ball.points.nbytes
