"""One crossing of a field, scored against the truth."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.crossing.knowledge import FieldKnowledge
from controllers.crossing.rover import StageError
from controllers.crossing.team import CrossingConfig, CrossingTeam
from experiments.ch5.insertion_scene import insertion_drawing, transform
from experiments.crossing.scene import (
    CARD_PLACE,
    MASTER,
    SLAVE,
    CrossingScene,
    draw_scene,
    roles,
    survey,
)
from experiments.mission.collisions import Collision, CollisionMonitor, TipOverMonitor
from models.compose import make_terrain
from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray
from twin.camera import StereoConfig
from twin.connect import Connection, connect
from twin.loop import LoopRecorder, Tick, run
from twin.realism import RealismName
from twin.robot import RobotError

LIMIT = 900.0
"""Longest crossing [s]."""
RATE = 4.0
"""Pairs of images a second."""
GATE = 22.46
"""Squared normalised error of a pose beyond which a belief is inconsistent: chi-squared with six
degrees of freedom exceeds it once in a thousand."""
_TRACKED = 100  # Ticks between two points of a track.
NEAR_PLACE = (0.05, math.radians(5.0))
"""Largest true distance [m] and turn [rad] of the slave from its place."""


@dataclasses.dataclass(frozen=True)
class CrossingTrial:
    """Settings of one crossing.

    Attributes:
        seed: Seed of field, initial poses, drawing, robots and sensors.
        without: Points of the map that are left out (`OMITTABLE`); empty for none.
        realism: How far simulated robots and their sensors are from their drawings.
        width: Width between the slot's walls [m].
    """

    seed: int
    without: str = ""
    realism: RealismName = "default"
    width: float = CARD_AND_SLOT.slot_widths[-1]


@dataclasses.dataclass
class Crossing:
    """A crossing, ready to run.

    Attributes:
        trial: Settings of the crossing.
        scene: Scene as built.
        team: Controllers of both rovers.
        connection: Connection to the robots.
    """

    trial: CrossingTrial
    scene: CrossingScene
    team: CrossingTeam
    connection: Connection

    def pose(self, body: str) -> RigidTransform:
        """Return a body's true pose, for scoring alone."""
        assert self.connection.simulation is not None
        return transform(self.connection.simulation.data, body)


@dataclasses.dataclass(frozen=True)
class BeliefResult:
    """A rover's belief of the slot after a stage, against the truth.

    Attributes:
        stage: Name of the stage.
        robot: Name of the rover.
        ended: Time at which both rovers had ended the stage [s].
        error: Distance of the slot from where the rover believes it to be [m].
        turn: Angle between its attitude and that believed [rad].
        nees: Squared normalised error of the pose, six degrees of freedom.
    """

    stage: str
    robot: str
    ended: float
    error: float
    turn: float
    nees: float

    @property
    def consistent(self) -> bool:
        """Whether the belief is within its own 99.9 % gate."""
        return self.nees <= GATE


@dataclasses.dataclass(frozen=True)
class CrossingResult:
    """Result of a crossing.

    Attributes:
        failed_stage: Stage that ended the crossing; empty if all were completed.
        reason: Why; empty without a failure.
        seconds: Duration in robot time [s].
        wall_over_sim: Wall time for each second of robot time.
        beliefs: Beliefs after each stage of each rover that was localized by then.
        place_error: Distance of the slave from its place before the slot [m]; NaN if it never got
            so far.
        place_turn: Angle between its heading and that of the place [rad].
        driven: Distance driven by master and slave [m].
        views: Number of views of master and slave that searched for the panel at rest.
        collisions: What the rovers touched.
        fallen: Names of the rovers that tipped over.
        tracks: (N, 2) true x, y of each rover, once a second [m], by its name.
    """

    failed_stage: str
    reason: str
    seconds: float
    wall_over_sim: float
    beliefs: tuple[BeliefResult, ...]
    place_error: float
    place_turn: float
    driven: tuple[float, float]
    collisions: tuple[Collision, ...]
    fallen: tuple[str, ...]
    tracks: dict[str, FloatArray]

    @property
    def inconsistent(self) -> str:
        """First stage after which a rover's belief was beyond its gate; empty if none was."""
        return next((each.stage for each in self.beliefs if not each.consistent), "")

    @property
    def arrived(self) -> bool:
        """Whether both are at their places, and every stage's beliefs hold against the truth."""
        near, turn = NEAR_PLACE
        there = self.place_error <= near and self.place_turn <= turn
        return not self.failed_stage and there and not self.inconsistent


class CrossingScorer(LoopRecorder):
    """Scores beliefs at the end of each stage against the truth, which no controller has.

    Attributes:
        beliefs: Beliefs after the stages that have ended.
        tracks: True x, y of each rover, once a second [m], by its name.
    """

    def __init__(self, crossing: Crossing) -> None:
        self.beliefs: list[BeliefResult] = []
        self.tracks: dict[str, list[FloatArray]] = {MASTER: [], SLAVE: []}
        self._crossing, self._ended = crossing, 0

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        team = self._crossing.team
        if tick.step % _TRACKED == 0:
            for name, track in self.tracks.items():
                track.append(np.array(self._crossing.pose(f"{name}/chassis").translation[:2]))
        for stage in team.ended[self._ended :]:
            self._ended += 1
            for name, knowledge in ((MASTER, team.master), (SLAVE, team.slave)):
                if knowledge.localization is not None:
                    self.beliefs.append(self._score(stage, name, knowledge, tick.time))

    def _score(self, stage: str, name: str, knowledge: FieldKnowledge, time: float) -> BeliefResult:
        believed, covariance = knowledge.slot_in_level()
        true = self._level(name).inv() * self._crossing.pose("slot")
        error = true * believed.inv()
        xi = np.asarray(error.as_exp_coords())
        apart = np.linalg.norm(true.translation - believed.translation)
        return BeliefResult(
            stage,
            name,
            time,
            float(apart),
            float(error.rotation.magnitude()),
            float(xi @ np.linalg.solve(covariance, xi)),
        )

    def _level(self, robot: str) -> RigidTransform:
        """Return the pose of a rover's frame, brought level: upright against gravity."""
        pose = self._crossing.pose(f"{robot}/chassis")
        up = np.array(self._crossing.scene.field.up)
        return RigidTransform.from_components(pose.translation, upright(pose.rotation, up))


def upright(rotation: Rotation, up: FloatArray) -> Rotation:
    """Return an attitude without pitch and roll, as an inclinometer takes them out.

    Args:
        rotation: Attitude of a body in a frame.
        up: (3,) unit vector against gravity in that frame.
    """
    x, y, z = rotation.inv().apply(up)
    tilt = np.array([math.asin(y), math.atan2(-x, z)])
    return rotation * Rotation.from_euler("XY", tilt).inv()


def generators(seed: int) -> list[np.random.Generator]:
    """Return the random generators of scene, drawing and controllers.

    Args:
        seed: Seed of the crossing; the simulation draws its noise from children of the seed itself.
    """
    return np.random.default_rng((seed, 2)).spawn(3)


@contextlib.contextmanager
def prepared(trial: CrossingTrial) -> Iterator[Crossing]:
    """Yield a crossing, ready to run, and take its robots down afterwards.

    Args:
        trial: Settings of the crossing.
    """
    scene_rng, site_rng, team_rng = generators(trial.seed)
    scene = draw_scene(trial.width, scene_rng)
    site = survey(scene, site_rng)
    with connect(
        "sim",
        robots=scene.robots,
        field=scene.field,
        stereo=StereoConfig(RATE),
        realism=trial.realism,
        seed=trial.seed,
    ) as connection:
        team = CrossingTeam(roles(trial.realism), site, CrossingConfig(trial.without), team_rng)
        yield Crossing(trial, scene, team, connection)


def perform(crossing: Crossing, recorders: Sequence[LoopRecorder] = ()) -> CrossingResult:
    """Run a crossing.

    Args:
        crossing: Crossing, from `prepared`.
        recorders: Recorders beside the scorer.
    """
    simulation, team, scene = crossing.connection.simulation, crossing.team, crossing.scene
    assert simulation is not None
    scorer = CrossingScorer(crossing)
    touches = CollisionMonitor(simulation, make_terrain(scene.field, scene.robots))
    falls = TipOverMonitor(simulation)
    failed, reason, wall = "", "", math.nan
    try:
        summary = run(
            crossing.connection.robots,
            [team],
            crossing.connection.clock,
            [scorer, touches, falls, *recorders],
            LIMIT,
            until=lambda: team.over,
        )
        wall = summary.wall / max(summary.duration, 1e-9)
        if not team.over:
            failed, reason = team.rovers[0].stage.name, "out of time"
    except StageError as error:
        failed, reason = error.stage, error.reason
    except RobotError as error:
        failed, reason = team.rovers[0].stage.name, str(error)
    apart, turn = math.nan, math.nan
    if "approach" in team.ended:
        apart, turn = _off_place(crossing)
    return CrossingResult(
        failed,
        reason,
        crossing.connection.clock.time,
        wall,
        tuple(scorer.beliefs),
        apart,
        turn,
        (team.master.navigator.odometry.distance, team.slave.navigator.odometry.distance),
        tuple(touches.collisions),
        tuple(falls.fallen),
        {name: np.array(track).reshape(-1, 2) for name, track in scorer.tracks.items()},
    )


def run_crossing(trial: CrossingTrial) -> CrossingResult:
    """Run one crossing; a job of the sweep.

    Args:
        trial: Settings of the crossing.
    """
    with prepared(trial) as crossing:
        return perform(crossing)


def _off_place(crossing: Crossing) -> tuple[float, float]:
    """Return the slave's true distance [m] and turn [rad] from its place before the slot."""
    ground = insertion_drawing(crossing.trial.width).transform_slot_to_ground
    robot = ground * crossing.pose("slot").inv() * crossing.pose(f"{SLAVE}/chassis")
    ahead = robot.rotation.apply([0.0, 1.0, 0.0])
    x, y, yaw = CARD_PLACE
    turn = math.remainder(math.atan2(-ahead[0], ahead[1]) - yaw, 2.0 * math.pi)
    return math.dist(robot.translation[:2], (x, y)), abs(turn)
