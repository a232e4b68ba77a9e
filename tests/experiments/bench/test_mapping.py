"""The scene with a closed-form truth, the scores, and the benchmark beside OctoMap."""

import json

import mujoco
import numpy as np
import pytest

from experiments.__main__ import main
from experiments.bench.mapping import (
    GROUND,
    MAX_DEPTH,
    Scene,
    exact_map,
    octomap,
    octomap_counts,
    random_view,
    recall,
    see,
)
from perception.voxels.occupancy import State


def mujoco_scene(scene):
    """Return a compiled model of the same shapes."""
    spec = mujoco.MjSpec()
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(type=plane, size=[0, 0, 0.1], pos=[0, 0, GROUND])
    for *centre, radius in scene.spheres:
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        spec.worldbody.add_geom(type=sphere, size=[radius, 0, 0], pos=centre)
    for box in scene.boxes:
        low, high = box[:3], box[3:]
        kind = mujoco.mjtGeom.mjGEOM_BOX
        spec.worldbody.add_geom(type=kind, size=(high - low) / 2, pos=(low + high) / 2)
    return spec.compile()


def test_rays_meet_what_mujoco_s_rays_meet():
    generator = np.random.default_rng(1)
    scene = Scene.random(generator)
    model = mujoco_scene(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    origin = np.array([0.7, -0.5, 0.6])
    directions = generator.uniform(-0.6, 0.6, (500, 3)) - origin
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found, geom, normal = scene.cast(origin, directions), np.zeros(1, dtype=np.int32), np.zeros(3)
    for direction, length in zip(directions, found):
        expected = mujoco.mj_ray(model, data, origin, direction, None, 1, -1, geom, normal)
        assert length == pytest.approx(expected if expected >= 0 else np.inf, rel=1e-9)
    hits = origin + found[np.isfinite(found), None] * directions[np.isfinite(found)]
    assert np.abs(scene.distance(hits)).max() < 1e-12


def test_distance_changes_by_a_metre_per_metre():
    generator = np.random.default_rng(4)
    scene = Scene.random(generator)
    points = generator.uniform([-0.6, -0.6, 0.05], [0.6, 0.6, 0.6], (500, 3))
    points = points[scene.distance(points) > 1e-3]
    steps = 1e-6 * np.eye(3)
    slope = [(scene.distance(points + s) - scene.distance(points - s)) / 2e-6 for s in steps]
    assert np.median(np.linalg.norm(slope, axis=0)) == pytest.approx(1.0, abs=1e-6)
    assert np.mean(np.abs(np.linalg.norm(slope, axis=0) - 1.0) < 1e-4) > 0.99


def test_a_cloud_lies_on_the_scene_up_to_its_noise():
    generator = np.random.default_rng(2)
    scene = Scene.random(generator)
    cloud = see(scene, random_view(generator), generator)
    assert np.abs(scene.distance(cloud.truth)).max() < 1e-12
    local = cloud.transform_camera_to_world.inv().apply(cloud.truth)
    assert local[:, 2].max() < MAX_DEPTH
    error = cloud.points - cloud.truth
    chi = np.einsum("ni,nij,nj->n", error, np.linalg.inv(cloud.covariances), error)
    assert chi.mean() == pytest.approx(3.0, rel=0.03)


def test_recall_counts_voxels_and_their_neighbours():
    true = np.array([[0, 0, 0], [5, 5, 5], [9, 9, 9]])
    cells = np.array([[0, 0, 0], [6, 5, 4]])
    assert recall(true, cells, (10, 10, 10)) == (1 / 3, 2 / 3)


def test_counts_are_octomap_s_on_a_cloud_of_the_scene():
    generator = np.random.default_rng(3)
    scene = Scene.random(generator)
    clouds = [see(scene, random_view(generator), generator)]
    ours, peer = exact_map(0.02, clouds).counts(), octomap_counts(octomap(0.02, clouds))
    assert {state: ours[state] for state in peer} == peer
    assert peer[State.OCCUPIED] > 1000


@pytest.mark.slow
def test_mapping_beside_octomap(tmp_path):
    assert main(["bench", "--only", "mapping", "--quick", "--out", str(tmp_path)]) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    for state in ("occupied", "free"):
        counts = measured[f"exact_voxels/{state}"]
        assert counts["ours"] == counts["octomap"] > 0
    # The speed is a figure of the report.
    for what in ("exact_1cm", "fast_1cm", "views"):
        assert measured[f"octomap_speedup/{what}"] > 0.0
    assert measured["surface_within_one_voxel/1cm"] > 0.99
    assert measured["surface_recall_within_one_voxel/1cm"] > 0.99
    assert 0.5 < measured["surface_nees/1cm"] < 2.0
    assert measured["views/same_verdict"] > 0.95
    assert measured["views/depth_difference_m"] < 0.01
