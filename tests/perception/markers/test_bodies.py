"""Markers are found to hundredths of a pixel, and make poses that are as sure as they say."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.markers.bodies import DETECTORS, find_bodies
from perception.markers.ellipses import MarkerExpectation, project_discs, shape_matrices
from perception.markers.poses import BodyCad, BodyPrior
from tests.perception.markers.marker_pictures import HEAD, picture, seen

CARD = BodyCad(np.array([[-0.038, -0.02, 0.0], [0.038, -0.02, 0.0]]))
SLOT = BodyCad(np.array([[-0.072, 0.015, 0.01], [0.072, 0.015, 0.01]]))


def poses(distance, slant, rng):
    """Card and slot that face the cameras, the slot ahead of the card."""
    turn = Rotation.from_euler("zyx", [rng.uniform(-0.3, 0.3), 0.5 * slant, np.pi + 0.8 * slant])
    slot = RigidTransform.from_components([0.015, -0.01, distance], turn)
    bend = Rotation.from_rotvec(rng.normal(0, 0.03, 3))
    return slot * RigidTransform.from_components([0.003, -0.015, 0.002], bend), slot


def pair(bodies, rng):
    left, right = np.concatenate([seen(b, c.points) for b, c in zip(bodies, (CARD, SLOT))], axis=1)
    return np.stack([picture(left, rng), picture(right, rng)])


def views(rng):
    return [(z, poses(z, s, rng)) for z in (0.4, 0.7, 1.0) for s in (0.0, 0.5, 0.9)]


def expected(distance):
    return MarkerExpectation(0.8 * distance, 1.2 * distance)


def test_an_ellipse_is_the_outline_of_the_disc():
    rng = np.random.default_rng(0)
    normal, centre = rng.standard_normal(3), np.array([0.05, -0.08, 0.5])
    normal /= np.linalg.norm(normal)
    a = np.cross(normal, [1, 0, 0])
    a /= np.linalg.norm(a)
    around = np.linspace(0, 2 * np.pi, 50)[:, None]
    rim = centre + 0.02 * (np.cos(around) * a + np.sin(around) * np.cross(normal, a))
    ellipse = project_discs(centre, normal, 0.02, HEAD)
    d = HEAD.project(rim)[:, :2] - ellipse[:2]
    on = np.einsum("ni,ij,nj->n", d, np.linalg.inv(shape_matrices(ellipse)), d)
    assert np.abs(on - 1).max() < 1e-9
    # The perspective of a slanted disc moves its ellipse's centre off the image of its own.
    assert np.linalg.norm(HEAD.project(centre)[:2] - ellipse[:2]) > 0.05


@pytest.mark.parametrize("name", DETECTORS)
def test_centres_are_right_to_a_twentieth_of_a_pixel_and_no_surer_than_they_say(name):
    rng = np.random.default_rng(1)
    errors, nees, missed = [], [], 0
    for distance, bodies in views(rng):
        truth = np.concatenate([seen(b, c.points)[0] for b, c in zip(bodies, (CARD, SLOT))])
        found = DETECTORS[name](picture(truth, rng), HEAD, expected(distance))
        for ellipse in truth:
            off = found.centres - ellipse[:2]
            nearest = np.argmin(np.linalg.norm(off, axis=1))
            if np.linalg.norm(off[nearest]) > 1.0:
                missed += 1
                continue
            errors.append(np.linalg.norm(off[nearest]))
            covariance = found.centre_covariances[nearest]
            nees.append(off[nearest] @ np.linalg.solve(covariance, off[nearest]) / 2)
            assert found.contrasts[nearest] == pytest.approx(175, rel=0.1)
            assert found.axes[nearest] == pytest.approx(
                np.sqrt(np.linalg.eigvalsh(shape_matrices(ellipse))[::-1]), abs=0.25
            )
    assert missed <= 1 and np.median(errors) < 0.05 and np.mean(nees) < 2.0


@pytest.mark.parametrize("name", DETECTORS)
def test_card_and_slot_are_distinguished_and_located(name):
    rng = np.random.default_rng(2)
    places, nees, found = [], [], 0
    for distance, bodies in views(rng):
        fits = find_bodies(pair(bodies, rng), HEAD, (CARD, SLOT), expected(distance), name)
        for fit, body in zip(fits, bodies):
            if fit is None:
                continue
            found += 1
            xi = (body * fit.transform_body_to_camera.inv()).as_exp_coords()
            nees.append(xi @ np.linalg.solve(fit.covariance, xi) / 6)
            off = fit.transform_body_to_camera.translation - body.translation
            places.append(np.linalg.norm(off) / distance**2)
    assert found >= 16 and np.median(places) < 2e-3 and np.median(nees) < 2.0


def test_a_known_normal_makes_the_turn_about_the_markers_line_surer():
    rng = np.random.default_rng(3)
    bodies = poses(0.7, 0.0, rng)
    images = pair(bodies, rng)
    information = np.diag([1, 1, 1, 0, 0, 0]) / np.deg2rad(1.0) ** 2
    priors = [BodyPrior(body, information) for body in bodies]
    alone = find_bodies(images, HEAD, (CARD, SLOT), expected(0.7))
    helped = find_bodies(images, HEAD, (CARD, SLOT), expected(0.7), priors=priors)
    for first, second in zip(alone, helped):
        assert first is not None and second is not None
        assert first.turn_sigma > np.deg2rad(1.2) and second.turn_sigma <= np.deg2rad(1.0)


def test_two_discs_at_another_distance_are_no_card():
    rng = np.random.default_rng(4)
    bodies = poses(0.5, 0.3, rng)
    other = BodyCad(CARD.points * [1.1, 1, 1])
    assert find_bodies(pair(bodies, rng), HEAD, (other, SLOT), expected(0.5))[0] is None


def test_upside_down_is_resolved_by_a_prior():
    rng = np.random.default_rng(5)
    card = poses(0.5, 0.3, rng)[0]
    over = card * RigidTransform.from_rotation(Rotation.from_euler("z", np.pi))
    images = np.stack([picture(e, rng) for e in seen(over, CARD.points)])
    prior = BodyPrior(over, np.diag([4.0, 4.0, 4.0, 0, 0, 0]))
    (fit,) = find_bodies(images, HEAD, (CARD,), expected(0.5), priors=[prior])
    assert fit is not None
    assert (fit.transform_body_to_camera.rotation.inv() * over.rotation).magnitude() < 0.2


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize("level", [0, 255])
def test_an_even_image_shows_nothing(name, level):
    images = np.full((2, HEAD.height, HEAD.width), level, np.uint8)
    assert find_bodies(images, HEAD, (CARD, SLOT), expected(0.5), name) == (None, None)


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize("bad", [np.zeros((2, 0, 0), np.uint8), np.zeros((2, 492, 510)),
                                 np.zeros((2, 492, 509), np.uint8)])  # fmt: skip
def test_what_is_no_image_of_the_camera_is_refused(name, bad):
    with pytest.raises(ValueError, match=r"needs \(492, 510\), uint8"):
        find_bodies(bad, HEAD, (CARD,), expected(0.5), name)


def test_wrong_arguments_are_named():
    images = np.zeros((2, 492, 510), np.uint8)
    with pytest.raises(ValueError, match="there are tht, blob"):
        find_bodies(images, HEAD, (CARD,), expected(0.5), "sift")
    with pytest.raises(ValueError, match="a left and a right"):
        find_bodies(images[:1], HEAD, (CARD,), expected(0.5))
    with pytest.raises(ValueError, match="got 0 for 1 bodies"):
        find_bodies(images, HEAD, (CARD,), expected(0.5), priors=[])
    with pytest.raises(ValueError, match="0 < nearest"):
        MarkerExpectation(0.5, 0.4)
    with pytest.raises(ValueError, match="N >= 2"):
        BodyCad(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="normal .*needs a unit vector"):
        BodyCad(CARD.points, normal=(0.0, 0.0, 2.0))
