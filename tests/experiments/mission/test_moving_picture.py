"""Moving picture of a mission: tracks where the rovers were, and a file that plays."""

from types import SimpleNamespace

import numpy as np
import PIL.Image
import pytest

from experiments.harness.figure_style import COLOURS, rgb
from experiments.mission.figures import ROLES
from experiments.mission.moving_picture import MovingPicture
from experiments.mission.scene import CARD_PLACE, MASTER, SLAVE, draw_scene
from experiments.mission.trial import MissionTrial, generators
from tests.controllers.motion.seen import seen_at
from twin.loop import Tick

SEED = 10
SIDE = 400


@pytest.fixture(scope="module")
def film():
    """Film of a mission made by hand: both rovers drive straight to the slave's place."""
    trial, now = MissionTrial(SEED), [0.0]
    scene = draw_scene(trial.width, generators(SEED)[0])
    begins = {robot.name: np.array(robot.position) for robot in scene.robots}

    def place(name):
        gone = now[0] / 30.0
        return np.array([*((1.0 - gone) * begins[name] + gone * np.array(CARD_PLACE[:2])), 0.0])

    mission = SimpleNamespace(
        trial=trial, scene=scene, place=place, insertion=None,
        connection=SimpleNamespace(simulation=object()),
    )  # fmt: skip
    film = MovingPicture(mission)  # pyright: ignore[reportArgumentType]
    for step in range(3001):
        now[0] = 0.01 * step
        film.record(Tick(step, now[0], {name: seen_at(now[0]) for name in begins}, {}))
    return film, begins


def pixel_of(place, begins):
    """Pixel (column, row) of a place in the field's part, square about all that is to be seen."""
    all_places = np.array([*begins.values(), CARD_PLACE[:2]])
    low, high = all_places.min(axis=0) - 1.5, all_places.max(axis=0) + 1.5
    half = 0.5 * (high - low).max()
    x, y = (np.asarray(place) - 0.5 * (low + high) + half) * SIDE / (2.0 * half)
    return round(x), round(SIDE - y)


def test_a_rover_is_drawn_where_it_is_and_its_track_where_it_was(film):
    moving, begins = film
    assert len(moving.frames) == 11 and moving.frames[0].shape == (SIDE, SIDE + SIDE // 2, 3)
    first, last = moving.frames[0], moving.frames[-1]
    for name in (MASTER, SLAVE):
        column, row = pixel_of(begins[name], begins)
        assert first[row, column].tolist() == list(rgb(COLOURS[ROLES[name]]))
        middle = pixel_of(0.5 * (begins[name] + CARD_PLACE[:2]), begins)
        near = last[middle[1] - 2 : middle[1] + 3, middle[0] - 2 : middle[0] + 3].reshape(-1, 3)
        assert np.abs(near.astype(int) - rgb(COLOURS[ROLES[name]])).sum(axis=1).min() < 60
    column, row = pixel_of(CARD_PLACE[:2], begins)
    assert last[row, column].tolist() == list(rgb(COLOURS["slave"]))  # Drawn after the master.


def test_the_film_plays(film, tmp_path):
    film[0].save(tmp_path / "mission.gif")
    with PIL.Image.open(tmp_path / "mission.gif") as played:
        assert played.n_frames == 11 and played.size == (SIDE + SIDE // 2, SIDE)
