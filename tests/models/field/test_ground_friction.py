"""Friction in patches: the map, and tyres that slide where the ground is too smooth."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
import scipy.stats

from models.compose import WHEELS, FieldConfig, RobotPlacement, make_model, make_terrain, settle
from models.ground_friction import TyreFriction
from perception.geometry.gravity import GRAVITY
from tests.models.scenes import PLAIN, tilt

LIMITS = (0.3, 0.9)
PATCHY = dataclasses.replace(PLAIN, size=(9.0, 6.0), friction_patches=LIMITS, seed=3)


def tyres(model, robot="rover1"):
    return [model.geom(f"{robot}/{wheel}_tyre").id for wheel in WHEELS]


def test_patches_are_uniform_between_the_limits_and_reach_both():
    field = dataclasses.replace(PATCHY, size=(60.0, 48.0))
    ground = make_terrain(field)
    assert ground.friction.coefficients.shape == (80, 100)
    # One point a patch.
    x, y = np.meshgrid(np.arange(-29.7, 30.0, 0.6), np.arange(-23.7, 24.0, 0.6))
    values = ground.friction_at(np.stack([x, y], axis=-1)).ravel()
    low, high = LIMITS
    assert values.min() >= low and values.max() <= high
    # Of 8000, none within 0.2 % of an end once in 10^7.
    assert values.min() < low + 0.002 * (high - low) and values.max() > high - 0.002 * (high - low)
    sigma = (high - low) / math.sqrt(12.0 * len(values))
    assert values.mean() == pytest.approx(0.5 * (low + high), abs=5.0 * sigma)
    assert scipy.stats.kstest(values, scipy.stats.uniform(low, high - low).cdf).pvalue > 1e-4
    # Neighbours do not know of each other.
    grid = values.reshape(x.shape)
    for ahead, behind in ((grid[1:], grid[:-1]), (grid[:, 1:], grid[:, :-1])):
        assert abs(np.corrcoef(ahead.ravel(), behind.ravel())[0, 1]) < 0.06


def test_friction_of_a_point_is_that_of_the_patch_with_the_nearest_middle():
    ground = make_terrain(PATCHY)
    rows, columns = ground.friction.coefficients.shape
    assert (rows, columns) == (10, 15)
    edge = 9.0 / columns, 6.0 / rows
    middles = np.stack(
        np.meshgrid(
            -4.5 + edge[0] * (np.arange(columns) + 0.5), -3.0 + edge[1] * (np.arange(rows) + 0.5)
        ),
        axis=-1,
    ).reshape(-1, 2)
    points = np.random.default_rng(0).uniform([-6.0, -4.0], [6.0, 4.0], (500, 2))
    inside = np.clip(points, [-4.5, -3.0], [4.5, 3.0])
    nearest = np.argmin(np.linalg.norm(inside[:, None] - middles, axis=-1), axis=1)
    wanted = ground.friction.coefficients.ravel()[nearest]
    np.testing.assert_array_equal(ground.friction_at(points), wanted)
    np.testing.assert_array_equal(ground.friction_at(points.reshape(5, 100, 2)).ravel(), wanted)


def test_one_seed_draws_one_map_and_all_else_is_as_without():
    bare = dataclasses.replace(PATCHY, friction_patches=None, relief=0.02, rocks=50, blocks=10)
    field = dataclasses.replace(bare, friction_patches=LIMITS)
    maps = [make_terrain(f).friction.coefficients for f in (field, field)]
    np.testing.assert_array_equal(*maps)
    other = make_terrain(dataclasses.replace(field, seed=4)).friction.coefficients
    assert not np.any(maps[0] == other)
    plain, patchy = (make_model(f, [RobotPlacement()]) for f in (bare, field))
    for name in ("geom_pos", "geom_size", "geom_friction", "hfield_data", "tex_data", "key_qpos"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(patchy, name))


def test_one_coefficient_is_a_map_of_one_patch_and_none_is_the_tyres_own():
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2))
    ground = make_terrain(dataclasses.replace(PLAIN, friction=0.45))
    np.testing.assert_array_equal(ground.friction_at(points), 0.45)
    with pytest.raises(ValueError, match="each robot's tyres decide"):
        make_terrain(PLAIN).friction_at(points)


@pytest.mark.parametrize("friction", [None, 0.5])
def test_scene_without_patches_has_no_map(friction):
    model = make_model(dataclasses.replace(PLAIN, friction=friction), [RobotPlacement()])
    assert model.nnumeric == 0 and TyreFriction.of(model) is None


def test_each_tyre_has_the_friction_of_the_ground_below_it_and_nothing_else_has():
    robots = [RobotPlacement("rover1", (0.1, -0.2), 0.4), RobotPlacement("rover2", (2.0, 1.0))]
    field = dataclasses.replace(PATCHY, friction_patch=0.2)
    model = make_model(field, robots)
    others = np.setdiff1d(np.arange(model.ngeom), tyres(model) + tyres(model, "rover2"))
    before = model.geom_friction.copy()
    data = settle(model, 0.1)
    ground = make_terrain(field, robots)
    for robot in ("rover1", "rover2"):
        where = tyres(model, robot)
        wanted = ground.friction_at(data.geom_xpos[where, :2])
        assert len(set(wanted)) > 1
        np.testing.assert_array_equal(model.geom_friction[where, 0], wanted)
        # The tyre's alone decides, whatever the ground's is.
        for contact in data.contact:
            for geom, own in zip(where, wanted):
                if geom in contact.geom:
                    assert contact.friction[0] == own
    np.testing.assert_array_equal(model.geom_friction[others], before[others])
    np.testing.assert_array_equal(model.geom_friction[:, 1:], before[:, 1:])


def test_a_worn_tyre_keeps_its_share_on_every_patch():
    field = dataclasses.replace(PATCHY, friction_patch=0.2)
    robots = [RobotPlacement("rover1", (0.1, -0.2), 0.4)]
    model, ground = make_model(field, robots), make_terrain(field, robots)
    data, feels = settle(model, 0.1), TyreFriction.of(model)
    feels.wear("rover1/rear_left_tyre", 0.5)
    feels.wear("rover1/rear_left_tyre", 0.2)
    where = tyres(model)
    for moved in (0.0, 0.5, -0.7):
        data.qpos[0] += moved
        feels.update(data)
        shares = [0.4 if wheel == "rear_left" else 1.0 for wheel in WHEELS]
        wanted = ground.friction_at(data.geom_xpos[where, :2]) * shares
        np.testing.assert_allclose(model.geom_friction[where, 0], wanted)


@pytest.fixture(scope="module")
def hillside():
    """A slope of 10 degrees along y whose patches of 2 m have 0.05 to 0.4."""
    return FieldConfig(
        size=(16.0, 16.0),
        friction_patches=(0.05, 0.4),
        friction_patch=2.0,
        slope=(0.0, math.radians(10.0)),
        texture_pixels=16,
        seed=1,
    )


def test_braked_rover_slides_as_the_inclined_plane_says_or_holds(hillside):
    slope = hillside.slope[1]
    middles = np.stack(np.meshgrid(*[np.arange(-7.0, 8.0, 2.0)] * 2), axis=-1).reshape(-1, 2)
    coefficients = make_terrain(hillside).friction_at(middles)
    slid = held = 0
    order = np.argsort(coefficients)
    for index in [*order[:4], *order[28:32], *order[-4:]]:
        friction, place = coefficients[index], middles[index]
        if abs(friction - math.tan(slope)) < 0.02:
            continue
        model = make_model(hillside, [RobotPlacement(position=tuple(place), arm=False)])
        # Brakes: the wheels' dry friction bears more than the tyres can pass on.
        data = settle(model, 0.2)
        chassis = data.body("rover1/chassis")
        speeds, times = [], 0.05 * np.arange(1.0, 7.0)
        for _ in times:
            mujoco.mj_step(model, data, 50)
            speeds.append(-data.joint("rover1/root_joint").qvel[1])
        assert np.all(np.abs(chassis.xpos[:2] - place) < 0.8)  # All wheels in its patch.
        assert np.abs(tilt(data, "rover1/chassis")).max() < 0.05
        if math.tan(slope) > friction:
            wanted = GRAVITY * (math.sin(slope) - friction * math.cos(slope))
            assert np.polyfit(times, speeds, 1)[0] == pytest.approx(wanted, rel=0.02)
            slid += 1
        else:
            assert np.abs(speeds).max() < 1e-3
            held += 1
    assert slid >= 4 and held >= 4


@pytest.mark.parametrize(
    "bad",
    [
        {"friction_patches": (0.0, 0.5)},
        {"friction_patches": (0.6, 0.5)},
        {"friction_patches": (0.5, 3.1)},
        {"friction_patches": (math.nan, 0.5)},
        {"friction_patches": LIMITS, "friction": 0.5},
        {"friction_patches": LIMITS, "friction_patch": 0.01},
    ],
)
def test_impossible_patches_are_refused_with_what_is_valid(bad):
    with pytest.raises(ValueError, match="field friction_patch.*: got .*, needs "):
        dataclasses.replace(PLAIN, **bad)
