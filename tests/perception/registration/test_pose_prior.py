"""Arm and fiducials give a pose together; errors common to all views of a robot remain."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from perception.geometry.se3 import adjoint
from perception.registration.fiducial_map import FiducialMap, PosePrior
from perception.registration.motion import RegistrationError
from tests.perception.registration.fiducial_views import HEAD, error_of, random_motion

SIGMA = 0.2
PLACE = np.diag([0.003, 0.003, 0.003, 0.004, 0.004, 0.004]) ** 2
MOUNT = np.diag([0.004, 0.004, 0.004, 0.001, 0.001, 0.001]) ** 2
OWN = np.diag([0.001] * 6) ** 2


@dataclasses.dataclass
class Robot:
    """A robot's pose and a mount, both a little wrong, and the arm's poses of the observations."""

    errors: np.ndarray
    sighting: RigidTransform
    offsets: np.ndarray

    def look(self, rng, degrees=12.0, metres=0.1):
        """A prior, and the true pose."""
        pose = random_motion(rng, degrees, metres)
        by = np.hstack([np.eye(6), adjoint(pose) - adjoint(self.sighting)])
        xi = by @ self.errors + rng.multivariate_normal(np.zeros(6), OWN)
        return PosePrior(pose, OWN, self.offsets, by), RigidTransform.from_exp_coords(xi) * pose


def shared():
    return np.block([[PLACE, np.zeros((6, 6))], [np.zeros((6, 6)), MOUNT]])


def robot(rng, fiducials):
    errors = rng.multivariate_normal(np.zeros(12), shared())
    return Robot(errors, random_motion(rng, 20.0, 0.2), fiducials.share(shared()))


def square(error, covariance):
    return float(error @ np.linalg.solve(covariance, error)) / error.size


class Field:
    """Points in the world, of which some are in the map."""

    def __init__(self, rng, count=60):
        self.points = rng.uniform([-0.45, -0.4, 0.8], [0.45, 0.4, 1.4], (count, 3))
        self.numbers = np.full(count, -1)  # In the map; -1 for none.

    def sight(self, rng, true, fresh=5, sigma=SIGMA):
        """Which points are in view, mapped and new, and their image points."""
        image = HEAD.project(true.apply(self.points, inverse=True))
        image = image + sigma * rng.standard_normal(image.shape)
        inside = np.all((image[:, :2] > 0) & (image[:, :2] < [HEAD.width, HEAD.height]), axis=1)
        old = np.flatnonzero(inside & (self.numbers >= 0))
        new = np.flatnonzero(inside & (self.numbers < 0))[:fresh]
        return old, new, image


def run(seed, robots=2, looks=6, few=12):
    """Two robots look in turn at one field."""
    rng = np.random.default_rng(seed)
    fiducials, field = FiducialMap(HEAD, np.full(3, SIGMA)), Field(rng)
    team = [robot(rng, fiducials) for _ in range(robots)]
    result: dict[str, Any] = {key: [] for key in ("arm", "observed", "arm_error", "error")}
    for n in range(looks * robots):
        prior, true = team[n % robots].look(rng)
        expected, covariance = fiducials.expected(prior)
        result["arm"].append(square(error_of(expected, true), covariance))
        old, new, image = field.sight(rng, true)
        old = old[:few]
        observed = fiducials.observe_from(prior, field.numbers[old], image[old], new=image[new])
        field.numbers[new] = observed.added
        pose = observed.registration
        xi = error_of(pose.transform_camera_to_world, true)
        result["observed"].append(square(xi, pose.covariance))
        at = true.apply([0.0, 0.0, 0.8])
        for key, camera in (
            ("arm_error", prior.transform_camera_to_world),
            ("error", pose.transform_camera_to_world),
        ):
            result[key].append(np.linalg.norm(camera.apply([0.0, 0.0, 0.8]) - at))
    assert np.linalg.eigvalsh(fiducials.covariance).min() > 0.0
    truth = np.zeros_like(fiducials.positions)
    known = field.numbers >= 0
    truth[field.numbers[known]] = field.points[known]
    result["offsets"] = square(
        np.concatenate([r.errors for r in team]) - fiducials.offsets, fiducials.offset_covariance
    )
    result["fiducials"] = square((truth - fiducials.positions).ravel(), fiducials.covariance)
    return result


@pytest.fixture(scope="module")
def runs():
    return [run(seed) for seed in range(12)]


def test_errors_of_poses_fiducials_and_offsets_are_consistent_with_their_covariances(runs):
    for key in ("arm", "observed", "fiducials", "offsets"):
        assert 0.8 < np.mean([np.mean(r[key]) for r in runs]) < 1.25, key


def test_errors_are_consistent_with_the_covariance_after_many_views(runs):
    assert 0.8 < np.mean([r["observed"][-2:] for r in runs]) < 1.25


def test_fiducials_do_not_make_the_arm_worse(runs):
    arm, observed = (np.mean([r[key] for r in runs]) for key in ("arm_error", "error"))
    assert observed < 0.8 * arm


def test_robots_that_see_the_same_are_brought_together():
    """How far apart two arms put a spot that both see, at first and after their looks."""
    apart, together = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        fiducials, field = FiducialMap(HEAD, np.full(3, 0.03)), Field(rng)
        looks = [member.look(rng, 3.0, 0.05) for member in [robot(rng, fiducials) for _ in "ab"]]

        def gap(looks=looks, fiducials=fiducials):
            spots = [
                fiducials.expected(prior)[0].apply(true.apply([0.0, 0.0, 1.1], inverse=True))
                for prior, true in looks
            ]
            return np.linalg.norm(np.subtract(*spots))

        apart.append(gap())
        for prior, true in looks:
            old, new, image = field.sight(rng, true, fresh=20, sigma=0.03)
            observed = fiducials.observe_from(prior, field.numbers[old], image[old], new=image[new])
            field.numbers[new] = observed.added
        together.append(gap())
    # What is left is of single looks, a millimetre and a milliradian each.
    assert np.mean(together) < 0.35 * np.mean(apart)


def second_look(seed, fresh=12):
    """A map by one look, and the next look at it by the same robot."""
    rng = np.random.default_rng(seed)
    fiducials, field = FiducialMap(HEAD, np.full(3, SIGMA)), Field(rng)
    member = robot(rng, fiducials)
    prior, true = member.look(rng, 3.0, 0.05)
    _, new, image = field.sight(rng, true, fresh=fresh)
    field.numbers[new] = fiducials.observe_from(prior, [], np.zeros((0, 3)), new=image[new]).added
    prior, true = member.look(rng, 3.0, 0.05)
    old, _, image = field.sight(rng, true)
    return fiducials, prior, field.numbers[old], image[old], true


def whiten(covariance, values):
    return np.linalg.solve(np.linalg.cholesky(covariance), values)


def test_no_number_of_views_of_its_own_fiducials_localizes_a_robot():
    rng = np.random.default_rng(2)
    fiducials, field = FiducialMap(HEAD, np.full(3, 0.03)), Field(rng)
    member = robot(rng, fiducials)
    for _ in range(10):
        prior, true = member.look(rng)
        old, new, image = field.sight(rng, true, sigma=0.03)
        observed = fiducials.observe_from(prior, field.numbers[old], image[old], new=image[new])
        field.numbers[new] = observed.added
        assert np.linalg.eigvalsh(observed.registration.covariance - PLACE).min() > -1e-12
    np.testing.assert_allclose(fiducials.offsets[:6], 0.0, atol=1e-9)
    np.testing.assert_allclose(fiducials.offset_covariance[:6, :6], PLACE, atol=1e-12)
    # But it gives the pose of the head on its mount.
    assert np.diag(fiducials.offset_covariance)[6:9].sum() < 0.7 * np.trace(MOUNT[:3, :3])


def test_sequential_views_agree_with_batch_weighted_least_squares():
    """With small errors all is linear, and the order does not matter."""
    tiny = 1e-3
    rng = np.random.default_rng(4)
    fiducials, field = FiducialMap(HEAD, np.full(3, tiny * SIGMA)), Field(rng)
    offsets = fiducials.share(tiny**2 * shared())
    errors = tiny * rng.multivariate_normal(np.zeros(12), shared())
    member, looks, poses = Robot(errors, random_motion(rng, 20.0, 0.2), offsets), [], []
    for _ in range(4):
        prior, _ = member.look(rng)
        own = tiny * rng.multivariate_normal(np.zeros(6), OWN)
        pose = prior.transform_camera_to_world
        true = RigidTransform.from_exp_coords(prior.by_offsets @ errors + own) * pose
        prior = dataclasses.replace(prior, covariance=tiny**2 * OWN)
        old, new, image = field.sight(rng, true, sigma=tiny * SIGMA)
        observed = fiducials.observe_from(prior, field.numbers[old], image[old], new=image[new])
        field.numbers[new] = observed.added
        seen = np.concatenate([old, new])
        poses.append(observed.registration)
        looks.append((prior, field.numbers[seen], image[seen]))
    places = fiducials.positions

    def residuals(x):
        shift, points = tiny * x[:12], places + tiny * x[12 + 24 :].reshape(-1, 3)
        parts = [whiten(tiny**2 * shared(), shift)]
        for k, (prior, numbers, image) in enumerate(looks):
            own = tiny * x[12 + 6 * k : 18 + 6 * k]
            pose = RigidTransform.from_exp_coords(prior.by_offsets @ shift + own)
            pose = pose * prior.transform_camera_to_world
            seen = HEAD.project(pose.apply(points[numbers], inverse=True))
            parts += [
                whiten(tiny**2 * OWN, own),
                ((seen - image) / (tiny * SIGMA)).ravel(),
            ]
        return np.concatenate(parts)

    batch = least_squares(residuals, np.zeros(36 + places.size), xtol=1e-12)
    covariances = np.linalg.inv(batch.jac.T @ batch.jac)
    sigma = np.sqrt(np.diag(covariances))
    assert np.abs((fiducials.offsets / tiny - batch.x[:12]) / sigma[:12]).max() < 0.02
    assert np.abs(batch.x[36:] / sigma[36:]).max() < 0.02
    np.testing.assert_allclose(
        np.sqrt(np.diag(fiducials.offset_covariance)) / tiny, sigma[:12], rtol=0.01
    )
    np.testing.assert_allclose(np.sqrt(np.diag(fiducials.covariance)) / tiny, sigma[36:], rtol=0.01)
    xi = tiny * (looks[-1][0].by_offsets @ batch.x[:12] + batch.x[30:36])
    best = RigidTransform.from_exp_coords(xi) * looks[-1][0].transform_camera_to_world
    off = error_of(poses[-1].transform_camera_to_world, best)
    assert np.abs(whiten(poses[-1].covariance, off)).max() < 0.02


@pytest.mark.parametrize("count", [1, 3, 6])
def test_match_that_the_prior_excludes_is_left_out(count):
    fiducials, prior, numbers, image, _ = second_look(6)
    wrong = image[:count].copy()
    wrong[0] += [80.0, 0.0, 0.0]
    observed = fiducials.observe_from(prior, numbers[:count], wrong)
    assert not observed.registration.inliers[0] and observed.registration.inliers[1:].all()


def test_match_that_the_prior_allows_but_the_others_do_not_is_left_out():
    fiducials, prior, numbers, image, _ = second_look(6)
    assert len(image) >= 6
    image[2] += [2.5, -2.5, 0.0]
    observed = fiducials.observe_from(prior, numbers, image).registration
    assert not observed.inliers[2] and observed.inliers.sum() == len(image) - 1


def test_two_matches_that_contradict_each_other_are_rejected():
    fiducials, prior, numbers, image, _ = second_look(6)
    image[1] += [2.5, -2.5, 0.0]
    expected, covariance = fiducials.expected(prior)
    offsets, positions = fiducials.offsets.copy(), fiducials.positions.copy()
    observed = fiducials.observe_from(prior, numbers[:2], image[:2]).registration
    assert not observed.inliers.any() and np.isnan(observed.chi_square)
    assert np.abs(error_of(observed.transform_camera_to_world, expected)).max() < 1e-12
    np.testing.assert_allclose(observed.covariance, covariance)
    np.testing.assert_array_equal(fiducials.offsets, offsets)
    np.testing.assert_array_equal(fiducials.positions, positions)


def test_matches_of_views_with_different_errors_are_all_accepted():
    """Three looks err each by its own several pixels; a fourth sees what all of them saw."""
    believed, count = 0, 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        fiducials, field = FiducialMap(HEAD, np.full(3, 0.03)), Field(rng)
        member = robot(rng, fiducials)
        for _ in range(3):
            prior, true = member.look(rng, 3.0, 0.05)
            prior = dataclasses.replace(prior, covariance=9.0 * OWN)
            true = random_motion(rng, 0.15, 0.002) * true
            _, new, image = field.sight(rng, true, fresh=8, sigma=0.03)
            observed = fiducials.observe_from(prior, [], np.zeros((0, 3)), new=image[new])
            field.numbers[new] = observed.added
        prior, true = member.look(rng, 3.0, 0.05)
        old, _, image = field.sight(rng, true, sigma=0.03)
        observed = fiducials.observe_from(prior, field.numbers[old], image[old])
        believed += observed.registration.inliers.sum()
        count += len(old)
    assert believed >= 0.98 * count > 40


def test_offsets_nobody_uses_change_nothing():
    rng = np.random.default_rng(8)
    field = Field(rng)
    image = HEAD.project(field.points[:12])
    seen = image + SIGMA * rng.standard_normal(image.shape)
    results = []
    for shares in (0, 12):
        fiducials = FiducialMap(HEAD, np.full(3, SIGMA))
        fiducials.share(np.eye(shares))
        fiducials.add(image, RigidTransform.identity())
        observed = fiducials.observe(np.arange(12), seen, new=image[:2]).registration
        results.append((observed.covariance, fiducials.positions, fiducials.covariance))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-15)


def test_bad_offsets_are_refused():
    fiducials = FiducialMap(HEAD, np.full(3, SIGMA))
    with pytest.raises(RegistrationError, match=r"expected \(K, K\)"):
        fiducials.share(np.zeros((6, 5)))
    with pytest.raises(RegistrationError, match="not finite"):
        fiducials.share(np.diag([1.0, np.nan]))
    nobody = PosePrior(RigidTransform.identity(), OWN, np.array([0]), np.zeros((6, 1)))
    with pytest.raises(RegistrationError, match=r"offsets \[0\]: the map has 0"):
        fiducials.expected(nobody)
    uneven = dataclasses.replace(nobody, by_offsets=np.zeros((6, 2)))
    with pytest.raises(RegistrationError, match=r"expected \(6, 1\)"):
        fiducials.expected(uneven)
