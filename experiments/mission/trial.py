"""One mission, from the initial poses to the seated card, scored against the truth."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import CameraStation
from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.team import InsertionSlave
from controllers.mission.stages.insert import InsertCard
from controllers.mission.stages.place import PlaceCamera
from controllers.mission.team import MissionConfig, MissionTeam
from controllers.placement.task import PlacementError
from experiments.ch2.rover.confidence import RobotIdentification
from experiments.ch2.rover.laboratory import laboratory_values
from experiments.ch5.insertion_scene import contact_force, insertion_drawing, transform
from experiments.mission.scene import MASTER, SLAVE, MissionScene, draw_scene, roles, survey
from models.compose import RobotPlacement
from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import point_jacobian
from twin.camera import StereoConfig
from twin.connect import Connection, connect
from twin.loop import LoopRecorder, Tick, run
from twin.realism import RealismName, make_robots
from twin.robot import RobotError

LIMIT = 300.0
"""Longest mission [s]."""
RATE = 4.0
"""Pairs of images a second."""


@dataclasses.dataclass(frozen=True)
class MissionTrial:
    """Settings of one mission.

    Attributes:
        seed: Seed of ground, initial poses, drawing, sensors and radio.
        without: Stage that is left out; empty for none.
        robot: Robots that are driven: sim, quantised, emulated or serial:PORT,...
        realism: How far simulated robots and their sensors are from their drawings.
        only: Last stage that is run; empty for all.
        width: Width between the slot's walls [m].
        scans: Number of views of the master alone, and of each robot when both have met.
    """

    seed: int
    without: str = ""
    robot: str = "sim"
    realism: RealismName = "ideal"
    only: str = ""
    width: float = CARD_AND_SLOT.slot_widths[-1]
    scans: tuple[int, int] = (4, 3)


@dataclasses.dataclass
class Mission:
    """A mission, ready to run.

    Attributes:
        trial: Settings of the mission.
        scene: Scene as built.
        team: Controllers of both rovers.
        connection: Connection to the robots.
    """

    trial: MissionTrial
    scene: MissionScene
    team: MissionTeam
    connection: Connection

    @property
    def insertion(self) -> InsertionSlave | None:
        """The slave's part of the insertion, once it has begun."""
        stage = self.team.slave.stage
        return stage.slave if isinstance(stage, InsertCard) else None

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


@dataclasses.dataclass(frozen=True)
class StageResult:
    """Errors and covariances of the estimates after a stage.

    Attributes:
        name: Name of the stage.
        ended: Time of the loop's clock at which both robots had ended the stage [s].
        master_error: (3,) error of the slot's position as the master estimates it, slot frame [m].
        master_sigma: (3,) standard deviations that the master expects, robot frame [m].
        slave_error: (3,) error of the slot's position as the slave estimates it, slot frame [m].
        slave_sigma: (3,) standard deviations that the slave expects, robot frame [m].
        turn_share: Share of rolling wheels' turn that skidding leaves, as identified by then.
        turn_share_sigma: Its standard deviation.
        turns: (2,) angles between the slot's attitude and that as master and slave estimate it
            [rad].
        slave_place: (3,) true x, y [m] and yaw [rad] of the slave, ground frame.
    """

    name: str
    ended: float
    master_error: FloatArray
    master_sigma: FloatArray
    slave_error: FloatArray
    slave_sigma: FloatArray
    turn_share: float
    turn_share_sigma: float
    turns: FloatArray
    slave_place: FloatArray


@dataclasses.dataclass(frozen=True)
class MissionResult:
    """Result of a mission.

    Attributes:
        success: Whether the slave reports success and the card is truly seated.
        reason: Reason of the failure; empty without one.
        seconds: Duration in robot time [s].
        wall_over_sim: Wall time for each second of robot time.
        peak: Largest true force on the card during the insertion [N]; NaN where it is not known.
        across: Position of the card across the slot at the end [m].
        ahead: Depth of the card in the slot at the end [m].
        stages: Stages that have ended, in their order.
        misses: (stops, 2) distance of the master from its station [m] and from its heading [rad]
            at each stop.
        identifications: Identification of each robot that ended one.
    """

    success: bool
    reason: str
    seconds: float
    wall_over_sim: float
    peak: float
    across: float
    ahead: float
    stages: tuple[StageResult, ...]
    misses: FloatArray
    identifications: tuple[RobotIdentification, ...] = ()

    @property
    def stage_names(self) -> list[str]:
        """Names of the stages that have ended, in their order."""
        return [stage.name for stage in self.stages]


class MissionScorer(LoopRecorder):
    """Scores a mission against the truth, which no controller has access to.

    Attributes:
        peak: Largest true force on the card during the insertion [N], 0 before it; NaN where it is
            not known.
        stages: Results of the stages that have ended.
        misses: Distance of the master from its station [m] and its heading [rad] at each stop.
    """

    def __init__(self, mission: Mission) -> None:
        self.peak = 0.0 if mission.connection.simulation is not None else math.nan
        self.stages: list[StageResult] = []
        self.misses: list[tuple[float, float]] = []
        self._mission = mission

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        mission = self._mission
        simulation = mission.connection.simulation
        if simulation is not None and mission.insertion is not None:
            force = contact_force(simulation.model, simulation.data)
            self.peak = max(self.peak, float(np.linalg.norm(force)))
        stage = mission.team.master.stage
        if isinstance(stage, PlaceCamera) and stage.stops > len(self.misses):
            self.misses.append(_miss(mission.poses(MASTER), stage.station))
        for name in mission.team.ended[len(self.stages) :]:
            tilt = np.asarray(tick.observations[MASTER].inclinometer.value, dtype=float)
            self.stages.append(self._result(name, tick.time, tilt))

    def _result(self, name: str, ended: float, tilt: FloatArray) -> StageResult:
        team = self._mission.team
        master, slave = self._mission.poses(MASTER), self._mission.poses(SLAVE)
        believed, covariance = team.master.belief.slot_in_robot(tilt)
        held = team.slave.belief
        (first, turn), (second, other) = (
            _offset(master, believed),
            _offset(slave, held.transform_slot_to_level),
        )
        return StageResult(
            name,
            ended,
            first,
            _sigma(believed, covariance),
            second,
            _sigma(held.transform_slot_to_level, held.slot_covariance),
            held.turn_share.share,
            held.turn_share.deviation,
            np.array([turn, other]),
            _place(slave),
        )


@contextlib.contextmanager
def prepared(trial: MissionTrial):  # noqa: ANN201
    """Yield a mission, ready to run, and take its robots down afterwards.

    Args:
        trial: Settings of the mission.
    """
    # The simulation draws its noise from children of the seed itself.
    scene_rng, site_rng, team_rng = np.random.default_rng((trial.seed, 1)).spawn(3)
    scene = draw_scene(trial.width, scene_rng)
    site = survey(scene, site_rng)
    with connect(
        trial.robot,
        robots=scene.robots,
        field=scene.field,
        stereo=StereoConfig(RATE),
        realism=trial.realism,
        seed=trial.seed,
    ) as connection:
        config = MissionConfig(trial.without, trial.scans)
        team = MissionTeam(roles(trial.realism), site, config, team_rng, connection.links)
        yield Mission(trial, scene, team, connection)


def perform(mission: Mission, recorders: Sequence[LoopRecorder] = ()) -> MissionResult:
    """Run a mission.

    Args:
        mission: Mission, from `prepared`.
        recorders: Recorders beside the scorer.
    """
    scorer = MissionScorer(mission)
    team, reason, wall = mission.team, "", math.nan
    try:
        summary = run(
            mission.connection.robots,
            [team],
            mission.connection.clock,
            [scorer, *recorders],
            LIMIT,
            until=lambda: team.over or mission.trial.only in team.ended,
        )
        wall = summary.wall / max(summary.duration, 1e-9)
        ended = team.over or mission.trial.only in team.ended
        reason = "" if ended else f"out of time in {team.slave.stage.name}"
    except (RobotError, PlacementError) as error:
        reason = str(error)
    poses = mission.poses(SLAVE)
    # Nobody measures the card of real robots: then the slave's report alone counts.
    place = (poses["slot"].inv() * poses["card"]).translation if poses else np.full(3, np.nan)
    success, insertion = False, mission.insertion
    if insertion is not None:
        inserter = insertion.inserter
        reason = reason or inserter.reason
        depth = inserter.config.guide.depth - 2e-3
        seated = not poses or place[1] >= depth and abs(place[2]) < 0.01  # noqa: PLR2004
        success = inserter.stage is InsertionStage.DONE and bool(seated)
    return MissionResult(
        success=success,
        reason=reason,
        seconds=mission.connection.clock.time,
        wall_over_sim=wall,
        peak=scorer.peak,
        across=float(place[0]),
        ahead=float(place[1]),
        stages=tuple(scorer.stages),
        misses=np.array(scorer.misses).reshape(-1, 2),
        identifications=tuple(_identifications(mission)),
    )


def _identifications(mission: Mission) -> Iterator[RobotIdentification]:
    trial = mission.trial
    made = make_robots(mission.scene.robots, trial.realism, trial.seed)
    for part, robot in zip((mission.team.master, mission.team.slave), made, strict=True):
        estimate = part.belief.identification
        if estimate is not None:
            truth = laboratory_values(RobotPlacement(made=robot.made))
            yield RobotIdentification.of(part.name, estimate, part.belief.doubts, truth)


def run_mission(trial: MissionTrial) -> MissionResult:
    """Run one mission; a job of the sweep.

    Args:
        trial: Settings of the mission.
    """
    with prepared(trial) as mission:
        return perform(mission)


def _miss(poses: Mapping[str, RigidTransform], station: CameraStation) -> tuple[float, float]:
    """Return a robot's distance from a camera station [m] and from its heading [rad]."""
    x, y, yaw = _place(poses) - station.place
    return math.hypot(x, y), abs(math.remainder(yaw, 2.0 * math.pi))


def _place(poses: Mapping[str, RigidTransform]) -> FloatArray:
    """Return a robot's x, y [m] and yaw [rad] in the ground frame, (3,)."""
    if not poses:
        return np.full(3, np.nan)
    ground = insertion_drawing(CARD_AND_SLOT.slot_widths[-1]).transform_slot_to_ground
    robot = ground * poses["slot"].inv() * poses["chassis"]
    ahead = robot.rotation.apply([0.0, 1.0, 0.0])
    return np.array([*robot.translation[:2], math.atan2(-ahead[0], ahead[1])])


def _offset(
    poses: Mapping[str, RigidTransform], believed: RigidTransform
) -> tuple[FloatArray, float]:
    """Return the error (3,) of the slot's position, slot frame [m], and of its attitude [rad]."""
    if not poses:
        return np.full(3, np.nan), math.nan
    error = poses["slot"].inv() * poses["chassis"] * believed
    return np.asarray(error.translation), float(error.rotation.magnitude())


def _sigma(believed: RigidTransform, covariance: FloatArray) -> FloatArray:
    """Return (3,) standard deviations of the position of a pose with covariance (6, 6) [m]."""
    motion = point_jacobian(believed.translation)
    return np.sqrt(np.diag(motion @ covariance @ motion.T))
