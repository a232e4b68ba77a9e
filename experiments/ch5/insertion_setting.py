"""Setting of a trial of ``ch5-insertion``: scene, robots, beliefs and controllers."""

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import (
    CameraStation,
    random_camera_station,
)
from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig
from controllers.insertion.guidance import GuidanceLink
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import (
    InsertionMaster,
    InsertionSlave,
    InsertionTeam,
    guide_config,
    marker_guide,
    seating_config,
    surrogate_sensing,
)
from controllers.mission.belief import TurnShare, drawn_slide, drawn_turn_share
from controllers.motion.base_tilt import BaseTilt, drawn_springs
from controllers.motion.driving import SkidSteer
from experiments.ch5.insertion_faults import Fault, FaultInjector
from experiments.ch5.insertion_identify import identify_slip, identify_springs
from experiments.ch5.insertion_scene import (
    FIELD,
    MASTER,
    SLAVE,
    InsertionScene,
    begin_with_camera_at,
    best_station,
    compile_insertion,
    insertion_drawing,
    place_insertion,
    transform_between,
)
from models import datasheets
from models.as_made import Change
from models.compose import RobotPlacement, settle
from models.datasheets import SensorErrorSheet
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import transport_covariance
from twin.camera import StereoConfig
from twin.describe import describe_rover
from twin.hardware.emulator.modem import virtual_links
from twin.link import Link
from twin.optics.realism import CameraRealism, RealismName
from twin.realism import Realism, as_stated, make_robots, realism_of, sensor_suites
from twin.robot import Robot
from twin.robot_clock import give_clocks
from twin.simulation import Simulation

Sheet = TypeVar("Sheet", SensorErrorSheet, CameraRealism)
RATE = 4.0
"""Pairs of images a second (thesis: 3 to 4)."""
NOISE_DB = datasheets.CAMERA.signal_to_noise_db


@dataclasses.dataclass(frozen=True, eq=False)
class Arrival:
    """Where the stages before an insertion leave the robots, and how well these know the slot.

    Attributes:
        slave: Middle of the slave's distance beside and behind the slot [m] and of its yaw [rad].
        spread: (3, 3) what three uniform draws from -1 to 1 add to these.
        station: Deviations of the master from its camera station along each axis [m], and of its
            heading [rad].
        slot: Deviations of the slot's attitude about [rad] and position along each axis [m], as
            each robot knows it: the master, the slave.
        share: Deviation of the slave's turn share from the ground's.
    """

    slave: tuple[float, float, float]
    spread: FloatArray
    station: tuple[float, float]
    slot: tuple[tuple[float, float], tuple[float, float]]
    share: float


OMITTABLE = ("identification", "placement", "replanning", "force", "cooperation")
"""What an ablation takes away: the slave's springs and slip as identified (those of the drawing
stay), the master's best camera station, the camera's moves after its first view, force guidance
(the card goes straight ahead), or what the master sees (the slave goes by its own map alone)."""
_HEAD_ERRORS = (
    "focal_error",
    "principal_error",
    "head_turn",
    "head_shift",
    "eye_turn",
    "eye_shift",
)
_SENSOR_ERRORS = tuple(
    field.name for field in dataclasses.fields(SensorErrorSheet) if field.name != "wrench_warm_up"
)
MAPPED = (4.5e-3, 1.7e-3)
"""Error of the map. `ch3-stereo` measured 95th percentiles of 4.8 mm
(`camera_error_mm/information/corrected`) and 12.6 mrad (`frame_turn_mrad`), which are 2.8
deviations of three equal normal axes."""
AS_MAPPED = Arrival(
    (0.0, 0.85, 0.0), np.diag([0.03, 0.05, 0.07]), (0.01, 0.01), (MAPPED, MAPPED), 0.0
)
"""Ideal robots, that only the map's errors lead astray."""
AS_IN_MISSION = Arrival(
    (0.01, 0.94, 0.02),
    np.array([[0.096, 0.0, 0.0], [0.0, 0.083, 0.0], [0.097, 0.0, 0.094]]),
    (0.024, 0.036),
    ((8.2e-3, 4.9e-3), (13.5e-3, 7.0e-3)),
    0.07,
)
"""Measured in 20 missions with robots as made, after their stage ``place``.

Means and deviations of `slave_place` are 9 (55), -938 (48) mm and 0.025 (0.078) rad. Place beside
and yaw are correlated by 0.72: where slaves come to rest turned to the left, they stand to the
right. Medians of `last_stop_miss_mm` 28 and `last_stop_miss_deg` 1.4, `slot_error_mm` 7.6 and 10.8,
`slot_error_deg` 0.72 and 1.19 (master, slave), `turn_share_sigma` 0.07. A median is 1.18, 0.67 and
1.54 deviations of two, one and three equal normal axes.
"""


@dataclasses.dataclass(frozen=True)
class Hardship:
    """What makes an insertion harder than the default field and robots.

    Springs and load change robots as made alone: those of `ideal` stay as drawn.

    Attributes:
        springs: Stiffness of the slave's springs over that when it was made.
        left_springs: Stiffness of those on its left over that as well.
        load: Mass on the slave's rear deck [kg].
        relief: Standard deviation of the ground's height [m].
        slope: Angle by which the ground rises beside the slave, to its right [rad].
        errors: Errors of both robots' sensors over those of the realism.
        head_errors: Errors of the heads' calibration over those of the realism.
        delay: Time that a pair of images is under way, beyond that of the realism [s].
        loss: Share of the radio's messages that are lost, if more than by the realism.
    """

    springs: float = 1.0
    left_springs: float = 1.0
    load: float = 0.0
    relief: float = FIELD.relief
    slope: float = 0.0
    errors: float = 1.0
    head_errors: float = 1.0
    delay: float = 0.0
    loss: float = 0.0

    @property
    def change(self) -> Change:
        """What happened to the slave."""
        return Change(self.load, springs=self.springs, left_springs=self.left_springs)

    def realism(self, named: RealismName) -> Realism:
        """Return a set of realism with these errors, delay and losses.

        Args:
            named: Name of the set.
        """
        chosen = realism_of(named)
        cameras = scaled(chosen.cameras, self.head_errors, *_HEAD_ERRORS)
        cameras = dataclasses.replace(cameras, latency=cameras.latency + self.delay)
        lost = max(chosen.modems.packet_loss, self.loss)
        errors = chosen.sensor_errors
        if errors is not None:
            errors = scaled(errors, self.errors, *_SENSOR_ERRORS)
        return dataclasses.replace(
            chosen,
            sensor_errors=errors,
            cameras=cameras,
            modems=dataclasses.replace(chosen.modems, packet_loss=lost),
        )


@dataclasses.dataclass(frozen=True)
class InsertionTrial:
    """Settings of one trial.

    Attributes:
        width: Width between the slot's walls, or the floors of its guides' grooves [m].
        optimal: Whether the camera is placed optimally, or at random.
        seed: Seed of field, initial poses, errors and noise, the same for both placements.
        noise_db: Signal-to-noise ratio of the cameras [dB].
        detector: Name of the marker detector.
        realism: How far robots, sensors and cameras are from their drawings.
        fault: Name of the `Fault` that happens; empty for none.
        trace: Whether the result holds the course.
        guides: Whether the slot is of card guides with a connector.
        hardship: What makes it harder.
        without: What is left out, one of `OMITTABLE`; empty for nothing.
    """

    width: float
    optimal: bool
    seed: int
    noise_db: float = NOISE_DB
    detector: str = "blob"
    realism: RealismName = "ideal"
    fault: str = ""
    trace: bool = False
    guides: bool = False
    hardship: Hardship = Hardship()
    without: str = ""


@dataclasses.dataclass
class Setting:
    """A trial, ready to run.

    Attributes:
        trial: Settings of the trial.
        scene: Poses of the robots, slot and ground.
        simulation: Simulation of the scene.
        robots: Robots as the controllers meet them, with the trial's fault.
        team: Controllers of both robots.
        station: Camera station of the master.
    """

    trial: InsertionTrial
    scene: InsertionScene
    simulation: Simulation
    robots: Mapping[str, Robot]
    team: InsertionTeam
    station: CameraStation


def prepare(trial: InsertionTrial) -> Setting:
    """Draw the scene's poses and the robots' priors.

    Args:
        trial: Settings of the trial.
    """
    # The simulation draws its noise from children of the seed itself.
    streams = np.random.default_rng((trial.seed, 1)).spawn(4)
    scene_rng, view_rng, prior_rng, radio_rng = streams
    hardship, realism = trial.hardship, trial.hardship.realism(trial.realism)
    master = as_stated(describe_rover(MASTER), realism)
    slave = describe_rover(SLAVE, card=True)
    drawing = insertion_drawing(trial.width, trial.guides)
    if trial.optimal and trial.without != "placement":
        station = best_station(trial.width)
    else:
        station = random_camera_station(master, drawing, view_rng)
    field = dataclasses.replace(
        FIELD,
        seed=int(scene_rng.integers(2**31)),
        texture_pixels=512,
        relief=hardship.relief,
        slope=(hardship.slope, 0.0),
    )
    arrival = AS_MAPPED if trial.realism == "ideal" else AS_IN_MISSION
    beside, ahead, yaw = arrival.slave + arrival.spread @ scene_rng.uniform(-1.0, 1.0, 3)
    # The master came by dead reckoning, and knows where it is by the map.
    away = np.array([arrival.station[0], *arrival.station]) * scene_rng.normal(size=3)
    x, y, heading = np.array(station.place) + away
    scene = InsertionScene(trial.width, (beside, -ahead, yaw), (x, y, heading), field, trial.guides)
    made = _robots_as_made(scene, trial)
    model = compile_insertion(scene, made)
    # Where the card is the master is told by the slave, as well as that knows where it stands.
    slot_error, card_error, slave_error = prior_rng.normal(size=(3, 6))
    known_to_master, known_to_slave = arrival.slot

    def guide_from(data: mujoco.MjData, angles: FloatArray, moves: bool) -> MarkerGuide:
        card = transform_between(data, f"{SLAVE}/card", f"{MASTER}/chassis")
        return marker_guide(
            master,
            drawing,
            _mapped_slot(data, MASTER, known_to_master, slot_error),
            _mapped(card, known_to_slave, card_error)[0],
            angles,
            moves,
            trial.detector,
        )

    # The camera is placed by the map before the task begins. On rough ground another posture of the
    # arm may let a robot slide by centimetres: the map is of the place where it comes to rest.
    begin_with_camera_at(model, station.angles)
    angles = guide_from(settle(model), station.angles, trial.optimal).begin()
    begin_with_camera_at(model, angles)
    begun = settle(model)
    guide = guide_from(begun, angles, trial.optimal and trial.without != "replanning")
    drawn = [master, slave]
    simulation = Simulation(
        model,
        drawn,
        suite=sensor_suites(realism.suite, realism.sensor_errors, drawn, trial.seed),
        stereo=StereoConfig(RATE, trial.noise_db, realism=realism.cameras),
        seed=trial.seed,
        data=begun,
    )
    springs, arm = drawn_springs(slave), CardArm(slave, drawing.tip)
    turns = drawn_turn_share(slave)
    if trial.without != "identification":
        share = identify_slip(made[1], trial.seed) + arrival.share * float(prior_rng.normal())
        turns = TurnShare(share, arrival.share)
        if trial.guides:
            springs = identify_springs(made[1], realism, trial.seed) or springs
    inserter = CardInserter(
        CardInserterConfig(
            guide_config(drawing, springs[0]),
            seating_config(drawing),
            forced=trial.without != "force",
            watched=trial.without != "cooperation",
        ),
        arm,
        dataclasses.replace(
            SkidSteer.of(slave, turns.share, turns.deviation), slide=drawn_slide(slave)
        ),
        *_mapped_slot(begun, SLAVE, known_to_slave, slave_error),
        BaseTilt(*springs, arm.mount) if trial.guides else None,
    )
    sensing = surrogate_sensing(slave, drawing.tip, springs)
    links: dict[str, Link] = dict(
        virtual_links([MASTER, SLAVE], lambda: simulation.time, radio_rng, realism.modems)
    )
    robots: dict[str, Robot] = dict(simulation.robots)
    if realism.clock is not None:
        robots = give_clocks(robots, realism.clock, trial.seed)
    if trial.fault:
        fault = FaultInjector(Fault[trial.fault], lambda: inserter.stage, lambda: simulation.time)
        robots, links = fault.robots(robots), fault.links(links)
    team = InsertionTeam(
        InsertionMaster(MASTER, guide, GuidanceLink(links[MASTER])),
        InsertionSlave(SLAVE, inserter, sensing, GuidanceLink(links[SLAVE])),
    )
    return Setting(trial, scene, simulation, robots, team, station)


def scaled(sheet: Sheet, factor: float, *names: str) -> Sheet:
    """Return a sheet with some of its numbers, by name, times a factor."""
    return dataclasses.replace(sheet, **{name: factor * getattr(sheet, name) for name in names})


def _robots_as_made(scene: InsertionScene, trial: InsertionTrial) -> tuple[RobotPlacement, ...]:
    """Return both robots as made, the slave changed by the trial's hardship."""
    master, slave = make_robots(place_insertion(scene)[1], trial.realism, trial.seed)
    if slave.made is None:
        return master, slave
    return master, dataclasses.replace(
        slave, made=dataclasses.replace(slave.made, change=trial.hardship.change)
    )


def _mapped_slot(
    data: mujoco.MjData, robot: str, known: tuple[float, float], error: FloatArray
) -> tuple[RigidTransform, FloatArray]:
    """Return the transform from the slot to a robot as the map has it, and its covariance."""
    return _mapped(transform_between(data, "slot", f"{robot}/chassis"), known, error)


def _mapped(
    pose: RigidTransform, known: tuple[float, float], error: FloatArray
) -> tuple[RigidTransform, FloatArray]:
    """Return a pose as the map has it, and its covariance: errors about the pose's own place.

    Args:
        pose: True pose.
        known: Deviations of the turn about [rad] and the place along each axis [m].
        error: (6,) error in these deviations.
    """
    deviations = np.repeat(known, 3)
    moved = RigidTransform.from_exp_coords(deviations * error)
    believed = RigidTransform.from_components(
        pose.translation + moved.translation, moved.rotation * pose.rotation
    )
    place = RigidTransform.from_translation(believed.translation)
    return believed, transport_covariance(place, np.diag(deviations**2))
