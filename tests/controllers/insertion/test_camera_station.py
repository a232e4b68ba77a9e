"""The best camera station among drawn obstacles: feasible, and as good as a fine grid's."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion import camera_station
from controllers.insertion.camera_station import (
    CameraStation,
    best_camera_station,
    camera_arm,
    is_clear,
)
from controllers.placement.mapped_ground import MappedGround
from controllers.placement.spatial.search import Accept, SearchConfig, SpatialTask, best_view
from controllers.placement.task import PlacementError, View
from experiments.ch5.insertion_scene import insertion_drawing
from models.datasheets import CARD_AND_SLOT
from perception.voxels.map import Surface
from twin.describe import describe_rover

ROVER = describe_rover("rover1")
DRAWING = insertion_drawing(CARD_AND_SLOT.slot_widths[-1])
SLOT = DRAWING.transform_slot_to_ground.translation
GRID = SearchConfig(level=4, rings=12, refine=False)
"""Candidates of the station as they are without refinement."""
FINE = SearchConfig(level=6, rings=48, refine=False)


def drawn_ground(seed: int) -> MappedGround:
    """Return ground with stakes that block it, and small boards before the slot that hide it."""
    rng = np.random.default_rng(seed)
    stakes = rng.uniform(-1.6, 1.6, (int(rng.integers(2, 9)), 2))
    heights = np.array([0.15, 0.20, 0.25, 0.30])
    points = [np.insert(heights[:, None], [0], stake, axis=1) for stake in stakes]
    across = 0.02 * np.stack(np.meshgrid(range(-2, 3), range(-2, 3)), axis=-1).reshape(-1, 2)
    for _ in range(int(rng.integers(1, 4))):
        middle = SLOT + rng.uniform([0.15, -0.4, -0.1], [0.6, 0.4, 0.25])
        points.append(middle + np.insert(across, 0, 0.0, axis=1))
    cloud = np.concatenate(points)
    surface = Surface(cloud, np.tile(1e-8 * np.eye(3), (len(cloud), 1, 1)), np.ones(len(cloud)))
    return MappedGround(surface, RigidTransform.identity())


@dataclasses.dataclass
class Search:
    """A search with other candidates, and what it found.

    Attributes:
        config: Candidates; None for those of the station.
        view: The best view.
    """

    config: SearchConfig | None = None
    view: View | None = None

    def __call__(self, task: SpatialTask, accept: Accept) -> View:
        """Search as `best_view` does."""
        config = self.config or task.config
        self.view = best_view(dataclasses.replace(task, config=config), accept)
        return self.view


def found(
    ground: MappedGround | None, config: SearchConfig | None, monkeypatch: pytest.MonkeyPatch
) -> tuple[CameraStation, View]:
    """Return the best station and its view; of the candidates of a search, if one is given."""
    search = Search(config)
    monkeypatch.setattr(camera_station, "best_view", search)
    station = best_camera_station(ROVER, DRAWING, ground=ground)
    assert search.view is not None
    return station, search.view


def camera_of(station: CameraStation) -> RigidTransform:
    """Return the pose of the camera at a station, ground frame, by the arm's joints."""
    x, y, yaw = station.place
    rover = np.array(
        [
            [math.cos(yaw), -math.sin(yaw), 0.0, x],
            [math.sin(yaw), math.cos(yaw), 0.0, y],
            [0.0, 0.0, 1.0, ROVER.centre_height],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return RigidTransform.from_matrix(rover) * camera_arm(ROVER)[0].tool_in_robot(station.angles)


@pytest.mark.parametrize("seed", [0, 4, 10, None])
def test_the_station_carries_the_refined_view(seed, monkeypatch) -> None:
    ground = None if seed is None else drawn_ground(seed)
    station, view = found(ground, None, monkeypatch)
    camera, (arm, _) = camera_of(station), camera_arm(ROVER)
    np.testing.assert_allclose(camera.translation, view.position, atol=1e-9)
    assert station.distance == pytest.approx(view.distance)
    # It points at the target, which is on the way of the card's and the slot's markers.
    target = camera.apply([0.0, 0.0, view.distance])
    assert math.dist(target, SLOT) < 0.15
    assert station.slant == pytest.approx(
        math.acos((view.position - target)[0] / view.distance), abs=1e-9
    )
    assert is_clear(station) and np.all(station.angles >= arm.limits[:, 0])
    assert np.all(station.angles <= arm.limits[:, 1])
    if ground is not None:
        assert ground.is_free(station.place[:2])


@pytest.mark.slow
def test_stations_are_no_worse_than_the_grid_s_and_as_good_as_a_fine_grid_s(monkeypatch) -> None:
    """Of 20 scenes: better by 2.3 % in the mean and up to 10 %, a fine grid's nowhere.

    Ten of them are enough here.
    """
    ratings = []
    for seed in range(10):
        ground = drawn_ground(seed)
        (_, grid), (_, refined), (_, fine) = (
            found(ground, config, monkeypatch) for config in (GRID, None, FINE)
        )
        ratings.append((grid.rating, refined.rating, fine.rating))
    grid, refined, fine = np.array(ratings).T
    print(f"gain {np.mean(refined / grid) - 1.0:.2%}, at most {np.max(refined / grid) - 1.0:.2%}")
    print(f"fine grid better by at most {np.max(fine / refined) - 1.0:.2%}")
    assert np.all(refined >= grid)
    assert np.all(refined > 0.99 * fine)
    assert np.max(refined / grid) > 1.03


def test_ground_without_a_free_place_has_no_station() -> None:
    x, y = (axis.ravel() for axis in np.mgrid[-2.0:2.0:0.1, -2.0:2.0:0.1])
    cloud = np.column_stack([x, y, np.full(len(x), 0.2)])
    surface = Surface(cloud, np.tile(1e-8 * np.eye(3), (len(cloud), 1, 1)), np.ones(len(cloud)))
    ground = MappedGround(surface, RigidTransform.identity())
    with pytest.raises(PlacementError, match="refused"):
        best_camera_station(ROVER, DRAWING, level=2, ground=ground)


def test_a_station_is_where_the_rover_may_stand() -> None:
    anywhere = best_camera_station(ROVER, DRAWING, level=2)
    side = math.copysign(1.0, anywhere.place[1])
    other = best_camera_station(
        ROVER, DRAWING, level=2, may_stand=lambda place: side * place[1] < -0.1
    )
    assert side * other.place[1] < -0.1
    with pytest.raises(PlacementError, match="refused"):
        best_camera_station(ROVER, DRAWING, level=2, may_stand=lambda _: False)
