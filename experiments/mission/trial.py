"""One mission, from the initial poses to the seated card, scored against the truth."""

import collections
import contextlib
import dataclasses
import math
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.seating import SeatingGuide
from controllers.insertion.team import InsertionSlave
from controllers.mapping.map_sharing import FRAGMENT, RECEIPT
from controllers.mission.config import MissionConfig
from controllers.mission.robot_mission import RobotMission
from controllers.mission.site import SiteDrawing
from controllers.mission.stage import StageError
from controllers.mission.stages.go_to import GoToPlace
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from controllers.mission.team import MissionTeam
from experiments.ch2.rover.confidence import RobotIdentification
from experiments.ch2.rover.laboratory import laboratory_values
from experiments.ch5.insertion_scene import (
    CardForces,
    in_slot,
    insertion_drawing,
    is_seated,
    transform,
)
from experiments.mission.collisions import Collision, CollisionMonitor, TipOverMonitor
from experiments.mission.scene import (
    CARD_PLACE,
    MASTER,
    SLAVE,
    Field,
    MissionScene,
    draw_scene,
    roles,
    survey,
)
from experiments.mission.shortest import shortest_path
from models.card_and_slot.guides import width_of
from models.compose import RobotPlacement, make_terrain
from models.datasheets import CARD_GUIDE
from perception.geometry.arrays import FloatArray
from twin.camera import StereoConfig
from twin.connect import Connection, LineConfig, connect
from twin.loop import LoopRecorder, Tick, run
from twin.optics.realism import RealismName
from twin.realism import make_robots, realism_of
from twin.robot import RobotError

LIMIT = 1500.0
"""Longest mission [s]."""
RATE = 4.0
"""Pairs of images a second."""
GATE = 22.46
"""Squared normalised error of a pose beyond which a belief is inconsistent: chi-squared with six
degrees of freedom exceeds it once in a thousand."""
NEAR_PLACE = (0.05, math.radians(5.0))
"""Largest true distance [m] and turn [rad] of the slave from its place."""
_TRACKED = 100  # Ticks between two points of a track.
MOST_FORCE = 30.0
"""Contact force on a card that is too large [N]."""


@dataclasses.dataclass(frozen=True)
class MissionTrial:
    """Settings of one mission.

    Attributes:
        seed: Seed of field, initial poses, drawing, robots, sensors and radio.
        without: What is left out, one of `OMITTABLE`; empty for nothing.
        loss: Share of the radio's messages that are lost, if more than by the realism.
        robot: Robots that are driven: sim, quantised, emulated or serial:PORT,...
        realism: How far simulated robots and their sensors are from their drawings.
        only: Last stage that is run; empty for all.
        clearance: Distance between each of the card's edges and its groove [m].
        hardness: How hard the field is to cross.
    """

    seed: int
    without: str = ""
    loss: float = 0.0
    robot: str = "sim"
    realism: RealismName = "default"
    only: str = ""
    clearance: float = CARD_GUIDE.clearances[1]
    hardness: Field = Field()

    @property
    def width(self) -> float:
        """Distance between the floors of the grooves [m]."""
        return width_of(self.clearance)


@dataclasses.dataclass
class Mission:
    """A mission, ready to run.

    Attributes:
        trial: Settings of the mission.
        scene: Scene as built.
        site: Drawing of the site, which the robots have.
        team: Controllers of both rovers.
        connection: Connection to the robots.
    """

    trial: MissionTrial
    scene: MissionScene
    site: SiteDrawing
    team: MissionTeam
    connection: Connection

    @property
    def insertion(self) -> InsertionSlave | None:
        """The slave's part of the insertion, once it has begun."""
        stage = self.team.slave.stage
        return stage.slave if isinstance(stage, InsertCard) else None

    @property
    def over(self) -> bool:
        """Whether the last stage that is run has ended."""
        return self.team.over or self.trial.only in self.team.ended

    def poses(self, robot: str) -> dict[str, RigidTransform]:
        """Return true poses, for scoring alone: chassis, slot, the slave's card; none if unknown.

        Args:
            robot: Name of the robot.
        """
        simulation, emulator = self.connection.simulation, self.connection.emulator
        if emulator is not None:
            bodies = emulator.state()[robot]["bodies"]
            return {
                name: RigidTransform.from_components(
                    pose["translation"], Rotation.from_matrix(pose["rotation"])
                )
                for name, pose in bodies.items()
            }
        if simulation is None:  # nobody measures real robots
            return {}
        names = {"chassis": f"{robot}/chassis", "slot": "slot"}
        if robot == SLAVE:
            names["card"] = f"{SLAVE}/card"
        return {name: transform(simulation.data, body) for name, body in names.items()}

    def place(self, robot: str) -> FloatArray:
        """Return a robot's true x, y [m] and yaw [rad] in the ground frame, (3,); NaN if unknown.

        Args:
            robot: Name of the robot.
        """
        poses = self.poses(robot)
        if not poses:
            return np.full(3, np.nan)
        ground = insertion_drawing(self.trial.width).transform_slot_to_ground
        pose = ground * poses["slot"].inv() * poses["chassis"]
        ahead = pose.rotation.apply([0.0, 1.0, 0.0])
        return np.array([*pose.translation[:2], math.atan2(-ahead[0], ahead[1])])


@dataclasses.dataclass(frozen=True)
class BeliefResult:
    """A rover's belief of the slot after a stage, against the truth.

    Attributes:
        stage: Name of the stage.
        robot: Name of the rover.
        ended: Time at which the rover had ended the stage [s].
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
class PathResult:
    """A rover's way from its first localization to its place.

    Attributes:
        robot: Name of the rover.
        driven: Distance driven, by its wheels [m].
        shortest: Length of the shortest collision-free path on the true field [m].
    """

    robot: str
    driven: float
    shortest: float


@dataclasses.dataclass(frozen=True)
class MissionResult:
    """Result of a mission.

    Attributes:
        failed_stage: Stage that ended the mission; empty if all that were to run were completed.
        reason: Why; empty without a failure.
        stages: Time at which both rovers had ended each stage [s], by name.
        seconds: Duration in robot time [s].
        wall_over_sim: Wall time for each second of robot time.
        beliefs: Beliefs after each stage of each rover that was localized by then.
        place_error: Distance of the slave from its place before the slot when it had ended its
            approach [m]; NaN where it never did, or the truth is not known.
        place_turn: Angle between its heading and that of the place [rad].
        misses: (stops, 2) distance of the master from its station [m] and from its heading [rad]
            at each of its stops.
        detected: Whether the master has seen card and slot in one pair.
        seated: Whether the slave reports success and the card is truly seated, see `is_seated`.
        peak: Largest true contact force on the card during the insertion [N]; NaN where it is not
            known.
        touch: Largest at one contact, while force guides the card before the connector [N].
        snap: Force at which the card snapped in, as felt [N]; NaN if it did not.
        card: (6,) pose of the card in the slot at the end: across, ahead, beside [m]; turn, yaw,
            roll [rad]; NaN where it is not known.
        driven: Distance driven by master and slave [m].
        paths: Ways from first localizations to places that were reached.
        collisions: What the rovers touched; none where it is not known.
        fallen: Names of the rovers that tipped over.
        tracks: (N, 2) true x, y of each rover, once a second [m], by its name.
        radio_bytes: Bytes on the air of both rovers, by stage.
        map_bytes: Those of them that carry parts of maps.
        notices: What both rovers said of the radio.
        identifications: Identification of each robot that ended one.
    """

    failed_stage: str
    reason: str
    stages: dict[str, float]
    seconds: float
    wall_over_sim: float
    beliefs: tuple[BeliefResult, ...]
    place_error: float
    place_turn: float
    misses: FloatArray
    detected: bool
    seated: bool
    peak: float
    touch: float
    snap: float
    card: FloatArray
    driven: tuple[float, float]
    paths: tuple[PathResult, ...]
    collisions: tuple[Collision, ...]
    fallen: tuple[str, ...]
    tracks: dict[str, FloatArray]
    radio_bytes: dict[str, int]
    map_bytes: int
    notices: tuple[str, ...]
    identifications: tuple[RobotIdentification, ...]

    @property
    def inconsistent(self) -> str:
        """First stage after which a rover's belief was beyond its gate; empty if none was."""
        return next((each.stage for each in self.beliefs if not each.consistent), "")

    @property
    def arrived(self) -> bool:
        """Whether both were at their places, the master saw card and slot, and all beliefs hold."""
        off = self.place_error > NEAR_PLACE[0] or self.place_turn > NEAR_PLACE[1]
        there = {"place", "approach"} <= set(self.stages)
        return there and self.detected and not off and not self.inconsistent

    @property
    def success(self) -> bool:
        """Whether both have arrived, and the card is seated, with no harm done."""
        harmed = self.peak > MOST_FORCE or bool(self.fallen)
        return self.arrived and self.seated and not harmed


class MissionScorer(LoopRecorder):
    """Scores a mission against the truth, which no controller has.

    Attributes:
        stages: Time at which both rovers had ended each stage [s], by name.
        beliefs: Beliefs after the stages that have ended.
        slave_place: (3,) true x, y [m] and yaw [rad] of the slave after its approach; NaN before.
        misses: Distance of the master from its station [m] and its heading [rad] at each stop.
        detected: Whether the master has seen card and slot in one pair.
        forces: Largest contact forces on the card during the insertion.
        paths: Ways from first localizations to places that were reached.
        tracks: True x, y of each rover, once a second [m], by its name.
    """

    def __init__(self, mission: Mission) -> None:
        self.stages: dict[str, float] = {}
        self.beliefs: list[BeliefResult] = []
        self.slave_place = np.full(3, np.nan)
        self.misses: list[tuple[float, float]] = []
        self.detected = False
        self.forces = CardForces()
        self.paths: list[PathResult] = []
        self.tracks: dict[str, list[FloatArray]] = {MASTER: [], SLAVE: []}
        self._mission = mission
        self._ended: dict[str, int] = {MASTER: 0, SLAVE: 0}
        self._localized: dict[str, tuple[FloatArray, float]] = {}

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        mission = self._mission
        if tick.step % _TRACKED == 0:
            for name, track in self.tracks.items():
                track.append(mission.place(name)[:2])
        if mission.connection.simulation is not None and mission.insertion is not None:
            guided = mission.insertion.inserter.guide is not None
            self.forces.note(mission.connection.simulation.data, guided)
        for name in mission.team.ended[len(self.stages) :]:
            self.stages[name] = tick.time
        for part in mission.team.parts:
            self._follow(part)
            for stage in part.ended[self._ended[part.name] :]:
                self._ended[part.name] += 1
                self._end(part, stage, tick.time)
        self._watch_master()

    def _watch_master(self) -> None:
        """Score the master's stops at its station, and note what it sees there."""
        stage = self._mission.team.master.stage
        if isinstance(stage, GoToPlace) and stage.stops > len(self.misses):
            x, y, yaw = self._mission.place(MASTER) - stage.place
            self.misses.append((math.hypot(x, y), abs(math.remainder(yaw, 2.0 * math.pi))))
        if isinstance(stage, GuideInsertion) and stage.sent is not None:
            self.detected |= stage.sent.card_seen and stage.sent.slot_seen

    def _follow(self, part: RobotMission) -> None:
        """Note where a rover is localized for the first time."""
        belief = part.belief
        if part.name not in self._localized and belief.localization is not None:
            place = self._mission.place(part.name)
            self._localized[part.name] = place, belief.navigator.odometry.distance

    def _end(self, part: RobotMission, stage: str, time: float) -> None:
        """Score what a rover believes, and where it is, after a stage."""
        mission, belief = self._mission, part.belief
        if belief.localization is None or stage == "insert":
            return
        if poses := mission.poses(part.name):
            self.beliefs.append(self._score(part, stage, time, poses))
        if (part.name, stage) in ((SLAVE, "approach"), (MASTER, "place")):
            place, before = self._localized[part.name]
            goal = mission.place(part.name)
            driven = belief.navigator.odometry.distance - before
            shortest = shortest_path(mission.scene, mission.site, place[:2], goal[:2])
            self.paths.append(PathResult(part.name, driven, shortest))
            if part.name == SLAVE:
                self.slave_place = goal

    def _score(
        self, part: RobotMission, stage: str, time: float, poses: Mapping[str, RigidTransform]
    ) -> BeliefResult:
        believed, covariance = part.belief.slot_in_level()
        chassis, up = poses["chassis"], np.array(self._mission.scene.field.up)
        level = RigidTransform.from_components(chassis.translation, upright(chassis.rotation, up))
        true = level.inv() * poses["slot"]
        error = true * believed.inv()
        xi = np.asarray(error.as_exp_coords())
        apart = np.linalg.norm(true.translation - believed.translation)
        return BeliefResult(
            stage,
            part.name,
            time,
            float(apart),
            float(error.rotation.magnitude()),
            float(xi @ np.linalg.solve(covariance, xi)),
        )


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
        seed: Seed of the mission; the simulation draws its noise from children of the seed itself.
    """
    return np.random.default_rng((seed, 2)).spawn(3)


@contextlib.contextmanager
def prepared(trial: MissionTrial, scene: MissionScene | None = None) -> Iterator[Mission]:
    """Yield a mission, ready to run, and take its robots down afterwards.

    Args:
        trial: Settings of the mission.
        scene: Scene; None for the one that the seed draws.
    """
    scene_rng, site_rng, team_rng = generators(trial.seed)
    scene = scene or draw_scene(trial.width, scene_rng, trial.hardness)
    site = survey(scene, site_rng)
    modems = realism_of(trial.realism).modems
    lost = max(trial.loss, modems.packet_loss)
    with connect(
        trial.robot,
        robots=scene.robots,
        field=scene.field,
        stereo=StereoConfig(RATE),
        realism=trial.realism,
        seed=trial.seed,
        lines=LineConfig(modems=dataclasses.replace(modems, packet_loss=lost)),
    ) as connection:
        config = MissionConfig(trial.without)
        team = MissionTeam(roles(trial.realism), site, config, team_rng, connection.links)
        yield Mission(trial, scene, site, team, connection)


def perform(mission: Mission, recorders: Sequence[LoopRecorder] = ()) -> MissionResult:
    """Run a mission.

    Args:
        mission: Mission, from `prepared`.
        recorders: Recorders beside the scorer.
    """
    simulation, team, scene = mission.connection.simulation, mission.team, mission.scene
    scorer, watched, touches, falls = MissionScorer(mission), list(recorders), None, None
    if simulation is not None:
        touches = CollisionMonitor(simulation, make_terrain(scene.field, scene.robots))
        falls = TipOverMonitor(simulation)
        watched += [touches, falls]
    failed, reason, begun = "", "", time.perf_counter()
    try:
        run(
            mission.connection.robots,
            [team],
            mission.connection.clock,
            [scorer, *watched],
            LIMIT,
            until=lambda: mission.over,
        )
        if not mission.over:
            failed, reason = team.stage, "out of time"
    except StageError as error:
        failed, reason = error.stage, error.reason
    except RobotError as error:
        failed, reason = team.stage, str(error)
    wall, seconds = time.perf_counter() - begun, mission.connection.clock.time
    sent = collections.Counter[str]()
    for part in team.parts:
        for (stage, _), count in part.radio.bytes_sent.items():
            sent[stage] += count
    apart, turn = _off_place(scorer.slave_place)
    card = _card_at_end(mission)
    return MissionResult(
        failed_stage=failed,
        reason=reason,
        stages=scorer.stages,
        seconds=seconds,
        wall_over_sim=wall / max(seconds, 1e-9),
        beliefs=tuple(scorer.beliefs),
        place_error=apart,
        place_turn=turn,
        misses=np.array(scorer.misses).reshape(-1, 2),
        detected=scorer.detected,
        seated=_is_seated(mission, card),
        peak=scorer.forces.peak if simulation is not None else math.nan,
        touch=scorer.forces.touch if simulation is not None else math.nan,
        snap=_snap_force(mission),
        card=card,
        driven=(
            team.master.belief.navigator.odometry.distance,
            team.slave.belief.navigator.odometry.distance,
        ),
        paths=tuple(scorer.paths),
        collisions=() if touches is None else tuple(touches.collisions),
        fallen=() if falls is None else tuple(falls.fallen),
        tracks={name: np.array(track).reshape(-1, 2) for name, track in scorer.tracks.items()},
        radio_bytes=dict(sent),
        map_bytes=sum(
            count
            for part in team.parts
            for (_, kind), count in part.radio.bytes_sent.items()
            if kind in (FRAGMENT, RECEIPT)
        ),
        notices=tuple(team.notices),
        identifications=tuple(_identifications(mission)),
    )


def run_mission(trial: MissionTrial) -> MissionResult:
    """Run one mission; a job of the sweep.

    Args:
        trial: Settings of the mission.
    """
    with prepared(trial) as mission:
        return perform(mission)


def _card_at_end(mission: Mission) -> FloatArray:
    """Return the true pose (6,) of the card in the slot, see `MissionResult`; NaN if unknown."""
    poses = mission.poses(SLAVE)
    if not poses:
        return np.full(6, np.nan)
    return in_slot(poses["slot"].inv() * poses["card"])


def _snap_force(mission: Mission) -> float:
    """Return the force at which the card snapped in, as felt [N]; NaN if it did not."""
    guide = None if mission.insertion is None else mission.insertion.inserter.guide
    return guide.snap_force if isinstance(guide, SeatingGuide) else math.nan


def _is_seated(mission: Mission, card: FloatArray) -> bool:
    """Return whether the slave reports a seated card, and where it is known it is one."""
    if mission.insertion is None:
        return False
    # Nobody measures the card of real robots: then the slave's report alone counts.
    done = mission.insertion.inserter.stage is InsertionStage.DONE
    return done and is_seated(card, mission.trial.width)


def _off_place(place: FloatArray) -> tuple[float, float]:
    """Return the slave's distance [m] and turn [rad] from its place before the slot."""
    x, y, yaw = place - CARD_PLACE
    return math.hypot(x, y), abs(math.remainder(yaw, 2.0 * math.pi))


def _identifications(mission: Mission) -> Iterator[RobotIdentification]:
    trial = mission.trial
    made = make_robots(mission.scene.robots, trial.realism, trial.seed)
    for part, robot in zip(mission.team.parts, made, strict=True):
        estimate = part.belief.identification
        if estimate is not None:
            truth = laboratory_values(RobotPlacement(made=robot.made))
            yield RobotIdentification.of(part.name, estimate, part.belief.doubts, truth)
