"""The field of a mission: what is drawn keeps its limits, and hides the panel."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from controllers.insertion.card_arm import CardArm
from experiments.ch5.insertion_scene import insertion_drawing
from experiments.mission.scene import (
    CARD_PLACE,
    INITIAL_PLACE_ERROR,
    INITIAL_YAW_ERROR,
    MASTER,
    SLAVE,
    WALL,
    draw_scene,
    roles,
    survey,
)
from experiments.mission.trial import generators
from models.compose import make_model, make_terrain
from models.datasheets import CARD_AND_SLOT

WIDTH = CARD_AND_SLOT.slot_widths[-1]
SEEDS = range(1, 41)
EYE = 0.6
"""Height of the head above the ground on the way, rounded up [m]."""


@pytest.fixture(scope="module")
def scenes():
    return {seed: draw_scene(WIDTH, generators(seed)[0]) for seed in SEEDS}


def test_initial_poses_are_within_their_ring_and_known_to_half_a_metre_and_30_degrees(scenes):
    for scene in scenes.values():
        places = [np.array(robot.position) for robot in scene.robots]
        assert all(3.0 <= np.linalg.norm(place) <= 8.0 for place in places)
        assert np.linalg.norm(places[0] - places[1]) >= 2.0
        for robot in scene.robots:
            off = np.array(scene.known[robot.name]) - [*robot.position, robot.yaw]
            assert np.abs(off[:2]).max() <= INITIAL_PLACE_ERROR
            assert abs(off[2]) <= INITIAL_YAW_ERROR
    errors = [
        np.array(scene.known[robot.name]) - [*robot.position, robot.yaw]
        for scene in scenes.values()
        for robot in scene.robots
    ]
    # Uniform: a deviation of 1 / sqrt(3) of the limit.
    limits = np.array([INITIAL_PLACE_ERROR, INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR])
    np.testing.assert_allclose(np.std(errors, axis=0), limits / math.sqrt(3.0), rtol=0.25)


def test_slopes_reach_ten_degrees_and_no_more(scenes):
    steep = np.degrees([math.hypot(*scene.field.slope) for scene in scenes.values()])
    assert steep.max() <= 10.0 and steep.max() > 8.0 and steep.min() < 2.0


def test_nothing_drawn_stands_where_the_slave_works(scenes):
    for scene in scenes.values():
        for screen in scene.field.screens:
            reach = math.hypot(*screen.size[:2]) / 2.0
            away = math.dist(screen.position, CARD_PLACE[:2])
            assert away - reach > (0.2 if screen.size == WALL else 0.3)


@pytest.mark.parametrize("seed", [5, 12, 31])
def test_no_rock_or_block_stands_below_the_card_that_the_slave_holds(seed, scenes):
    scene = scenes[seed]
    terrain = make_terrain(scene.field, scene.robots)
    slave = next(robot for robot in scene.robots if robot.name == SLAVE)
    arm = CardArm(roles().slave, insertion_drawing(WIDTH).tip)
    _, ahead, _ = arm.transform_card_to_robot(arm_home()).translation
    card = slave.position + ahead * np.array([-math.sin(slave.yaw), math.cos(slave.yaw)])
    for solids in (terrain.rocks, terrain.blocks):
        away = np.linalg.norm(solids.centres[:, :2] - card, axis=1) - solids.radii
        assert away.min() > 0.1


def arm_home():
    arm = roles().slave.arm
    assert arm is not None
    return arm.home


def test_the_panel_is_hidden_from_both_initial_poses_in_at_least_half_of_the_seeds(scenes):
    """Rays from heads that stand as high as on the way, to every marker."""
    hidden = []
    for scene in scenes.values():
        panel = scene.field.panel
        plain = dataclasses.replace(scene.field, texture_pixels=16, rocks=0, blocks=0)
        bare = make_model(plain, ())
        data = mujoco.MjData(bare)
        mujoco.mj_forward(bare, data)
        body = data.body("panel")
        turn = body.xmat.reshape(3, 3)
        marks = body.xpos + panel.marker_points @ turn.T
        hidden.append(
            all(_hidden(bare, data, robot.position, marks, turn) for robot in scene.robots)
        )
    assert np.mean(hidden) >= 0.5


def _hidden(model, data, place, marks, turn):
    """Whether fewer than three markers are seen from heads about a place."""
    for angle in np.linspace(-math.pi, math.pi, 12, endpoint=False):
        eye = np.array([place[0] + 0.15 * math.cos(angle), place[1] + 0.15 * math.sin(angle), EYE])
        seen = 0
        for mark in marks:
            away = eye - mark
            if away @ turn[:, 2] <= 0.0:
                continue  # the panel's back
            geom = np.zeros(1, np.int32)
            start = mark + 0.01 * turn[:, 2]
            far = mujoco.mj_ray(model, data, start, away, None, 1, -1, geom)
            seen += far < 0.0 or far > 1.0
        if seen >= 3:
            return False
    return True


def test_survey_states_the_site_within_its_deviations(scenes):
    scene = scenes[1]
    site = survey(scene, generators(1)[1])
    x, y, z = site.transform_panel_to_ground.translation
    panel = scene.field.panel
    assert math.dist((x, y), panel.position) < 0.1  # its middle lies over its lower edge
    assert 0.05 < z < 0.35
    assert site.initial_poses == scene.known


def test_roles_look_over_the_card():
    drawn = roles("default")
    assert drawn.master.name == MASTER and drawn.slave.name == SLAVE
    assert drawn.slave.head is not None and drawn.master.head is not None


def test_errors_of_the_drawing_are_consistent_with_its_covariance() -> None:
    scene = draw_scene(WIDTH, np.random.default_rng(0))
    exact = survey(scene, _Zeros())
    squares = []
    for seed in range(24):
        drawn = survey(scene, np.random.default_rng(seed))
        error = exact.transform_slot_to_panel * drawn.transform_slot_to_panel.inv()
        xi = np.asarray(error.as_exp_coords())
        squares.append(xi @ np.linalg.solve(drawn.covariance, xi))
    # Of 24 draws of chi squared with six degrees of freedom the mean lies within three deviations.
    assert 3.9 < np.mean(squares) < 8.1


class _Zeros(np.random.Generator):
    """Draws no errors."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def normal(self, *_: object, size: int = 1, **__: object) -> np.ndarray:
        return np.zeros(size)
