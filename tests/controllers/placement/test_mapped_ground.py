"""Free positions of a rover on a map, against counting points, and occluders of a target."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.placement.mapped_ground import GroundConfig, MappedGround
from perception.voxels.map import Surface

LEVEL = RigidTransform.identity()
HOW = GroundConfig()


def surface(points, sigma=1e-4):
    points = np.asarray(points, dtype=float)
    covariances = np.tile(sigma**2 / 3.0 * np.eye(3), (len(points), 1, 1))
    return Surface(points, covariances, np.ones(len(points)))


def test_a_place_is_free_if_fewer_than_three_points_of_its_disc_are_obstacles():
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -2, 0.0], [2, 2, 0.6], (300, 3))
    turn = RigidTransform.from_components([0.3, -0.2, 0.1], Rotation.from_euler("z", 0.7))
    ground = MappedGround(surface(turn.apply(points)), turn.inv())
    answers = []
    for place in rng.uniform(-2.0, 2.0, (400, 2)):
        count = 0
        for x, y, z in points:
            inside = (x - place[0]) ** 2 + (y - place[1]) ** 2 < 0.30**2
            count += inside and 0.08 + 1e-4 < z < 0.45
        answers.append(ground.is_free(place))
        assert answers[-1] == (count < 3)
    assert 50 < sum(answers) < 350


def test_a_point_as_uncertain_as_its_height_over_the_limit_is_no_obstacle():
    stake = [[0.1, 0.0, 0.10]] * 3
    assert not MappedGround(surface(stake, 0.019), LEVEL).is_free([0.0, 0.0])
    assert MappedGround(surface(stake, 0.021), LEVEL).is_free([0.0, 0.0])


def test_nothing_mapped_is_free_everywhere():
    for mapped in (None, surface(np.zeros((0, 3)))):
        ground = MappedGround(mapped, LEVEL)
        assert ground.is_free([0.0, 0.0]) and not len(ground.points)
        assert ground.occluders(np.zeros(3), np.array([1.0, 0.0, 0.0])) == []


def test_occluders_are_what_is_mapped_before_a_target_and_near_it():
    position, normal = np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0])
    kept = [[0.3, 0.0, 0.3], [0.06, 0.5, 0.2]]
    left_out = [[0.04, 0.0, 0.3], [-0.3, 0.0, 0.3], [0.95, 0.0, 0.3], [0.3, 0.0, 0.05]]
    found = MappedGround(surface(kept + left_out), LEVEL).occluders(position, normal)
    middles = np.array(sorted(part.points.mean(axis=0).tolist() for part in found))
    np.testing.assert_allclose(middles, sorted(kept), atol=0.51 * HOW.voxel)
