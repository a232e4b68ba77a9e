"""Collisions and falls of rovers, from the truth, for scoring alone: recorders of the loop."""

import dataclasses
import math
import re
from collections.abc import Sequence

import mujoco
import numpy as np

from models.ground_friction import TYRE
from models.terrain import Terrain
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from twin.loop import LoopRecorder, Tick
from twin.simulation import Simulation

HIGHEST = 0.025
"""Height over the bare ground up to which a wheel drives over things [m]: half its radius."""
GAP = 1.0
"""Time from which another contact of the same two is another collision [s]."""
STEEPEST = math.radians(60.0)
"""Tilt from which a rover has fallen over [rad]."""

# Kinds of geoms.
_GROUND, _TYRE, _OBSTACLE, _CARD, _SLOT, _OTHER = range(6)
_OBSTACLE_NAME = re.compile(r"(rock|block|screen)\d+")
_HARMLESS = np.zeros((6, 6), dtype=bool)
for _first, _second in ((_GROUND, _TYRE), (_CARD, _SLOT)):
    _HARMLESS[_first, _second] = _HARMLESS[_second, _first] = True


@dataclasses.dataclass(frozen=True)
class Collision:
    """One robot's contact with what is not its own.

    Attributes:
        robot: Name of the robot.
        geom: Its geom that touched.
        touched: Geom that was touched.
        begin: Time of the first contact [s].
        end: Time of the last contact [s].
    """

    robot: str
    geom: str
    touched: str
    begin: float
    end: float


class CollisionMonitor(LoopRecorder):
    """Records what robots touch at each tick.

    Anything of a robot but its tyres against anything that is not its own is a collision, and so is
    a tyre against anything but the ground and low rocks, blocks and screens: those whose top, where
    they are touched, is at most `highest` above the bare ground. The card in a gripper may touch
    the slot's walls: that is the task. A contact between two ticks, shorter than 10 ms, is missed.

    Args:
        simulation: Simulation of the robots.
        ground: Ground of its scene.
        highest: Height over the bare ground up to which tyres may touch things [m].
        gap: Time from which another contact of the same two is another collision [s].
    """

    def __init__(
        self, simulation: Simulation, ground: Terrain, highest: float = HIGHEST, gap: float = GAP
    ) -> None:
        self._model, self._data, self._ground = simulation.model, simulation.data, ground
        self._highest, self._gap = highest, gap
        self._robots = list(simulation.robots)
        self._names = [_geom_name(self._model, geom) for geom in range(self._model.ngeom)]
        self._kinds = _kinds(self._model, self._names)
        self._owners = _owners(self._model, self._robots)
        self._found: list[Collision] = []
        self._latest: dict[tuple[int, int], int] = {}

    @property
    def collisions(self) -> tuple[Collision, ...]:
        """Collisions so far, by the time at which they began."""
        return tuple(self._found)

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        pairs = self._data.contact.geom
        kinds = self._kinds[pairs]
        odd = ~_HARMLESS[kinds[:, 0], kinds[:, 1]]
        if not odd.any():
            return
        owners = self._owners[pairs]
        odd &= (owners[:, 0] != owners[:, 1]) & (self._data.contact.dist <= 0.0)
        odd &= ~self._driven_over(pairs, kinds)
        for first, second in pairs[odd].tolist():
            for geom, other in ((first, second), (second, first)):
                if self._owners[geom] >= 0:
                    self._note(geom, other, tick.time)

    def _driven_over(self, pairs: IndexArray, kinds: IndexArray) -> BoolArray:
        """Return (contacts,) whether each is that of a tyre with a low obstacle."""
        low = np.sort(kinds, axis=1) @ [10, 1] == 10 * _TYRE + _OBSTACLE
        touched = np.flatnonzero(low)
        if len(touched):
            obstacles = np.where(kinds[touched] == _OBSTACLE, pairs[touched], 0).max(axis=1)
            points = self._data.contact.pos[touched]
            low[touched] = self._rises(obstacles, points) <= self._highest
        return low

    def _rises(self, geoms: IndexArray, points: FloatArray) -> FloatArray:
        """Return (N,) how far obstacles' tops at points (N, 3) are above the bare ground [m]."""
        model = self._model
        centres, sizes = self._data.geom_xpos[geoms], model.geom_size[geoms]
        axes = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        local = np.einsum("nij,ni->nj", axes, points - centres)
        inside = 1.0 - np.sum((local[:, :2] / sizes[:, :2]) ** 2, axis=1)
        domes = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_ELLIPSOID
        shares = np.where(domes, np.sqrt(np.maximum(inside, 0.0)), 1.0)
        return centres[:, 2] + sizes[:, 2] * shares - self._ground.ground_at(points[:, :2])

    def _note(self, geom: int, touched: int, time: float) -> None:
        """Begin a collision, or let the latest of the same two last."""
        index = self._latest.get((geom, touched))
        if index is not None and time - self._found[index].end < self._gap:
            self._found[index] = dataclasses.replace(self._found[index], end=time)
            return
        self._latest[geom, touched] = len(self._found)
        robot = self._robots[self._owners[geom]]
        self._found.append(
            Collision(robot, self._names[geom], self._names[touched], begin=time, end=time)
        )


class TipOverMonitor(LoopRecorder):
    """Records which robots have fallen over: by the ground's normal, or by gravity.

    Args:
        simulation: Simulation of the robots.
        steepest: Angle between a chassis' up axis and either from which it has fallen [rad].

    Attributes:
        fallen: Time at which each robot that has fallen had first [s], by name.
    """

    def __init__(self, simulation: Simulation, steepest: float = STEEPEST) -> None:
        self.fallen: dict[str, float] = {}
        self._axes, self._robots = simulation.data.xmat, list(simulation.robots)
        model = simulation.model
        self._bodies = [model.body(f"{robot}/chassis").id for robot in self._robots]
        gravity = np.asarray(model.opt.gravity, dtype=float)
        self._ups = np.column_stack([[0.0, 0.0, 1.0], -gravity / np.linalg.norm(gravity)])
        self._least = math.cos(steepest)

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        upright = self._axes[self._bodies, 2::3] @ self._ups
        if upright.min() >= self._least:
            return
        for robot, steep in zip(self._robots, upright.min(axis=1) < self._least):
            if steep:
                self.fallen.setdefault(robot, tick.time)


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or that of its body if it has none."""
    return model.geom(geom).name or model.body(model.geom_bodyid[geom]).name


def _kinds(model: mujoco.MjModel, names: Sequence[str]) -> IndexArray:
    """Return (ngeom,) the kind of each geom."""
    kinds = np.full(model.ngeom, _OTHER, dtype=np.intp)
    for geom, name in enumerate(names):
        body = model.body(model.geom_bodyid[geom]).name
        if name == "ground":
            kinds[geom] = _GROUND
        elif name.endswith(TYRE):
            kinds[geom] = _TYRE
        elif _OBSTACLE_NAME.fullmatch(name):
            kinds[geom] = _OBSTACLE
        elif body.endswith("/card"):
            kinds[geom] = _CARD
        elif body.startswith("slot") or name.startswith("bracket"):
            kinds[geom] = _SLOT  # With the springs of its connector, and what holds it behind.
    return kinds


def _owners(model: mujoco.MjModel, robots: Sequence[str]) -> IndexArray:
    """Return (ngeom,) the index of the robot that each geom belongs to, -1 for none."""
    roots = [model.body(f"{robot}/chassis").rootid[0] for robot in robots]
    owners = np.full(model.ngeom, -1, dtype=np.intp)
    for index, root in enumerate(roots):
        owners[model.body_rootid[model.geom_bodyid] == root] = index
    return owners
