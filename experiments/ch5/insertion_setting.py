"""The setting of ``ch5-insertion``: scene, robots, what they believe, and their controllers."""

import dataclasses
from collections.abc import Mapping

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import (
    CameraStation,
    camera_arm,
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
    marker_guide_config,
    surrogate_sensing,
)
from controllers.motion.base_tilt import drawn_springs
from experiments.ch5.insertion_faults import Fault, FaultInjector
from experiments.ch5.insertion_identify import rover_steer
from experiments.ch5.insertion_scene import (
    MASTER,
    SLAVE,
    InsertionScene,
    begin_with_camera_at,
    best_station,
    compile_insertion,
    insertion_drawing,
    transform,
)
from models import datasheets
from models.compose import FieldConfig, settle
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import transport_covariance
from perception.stereo.geometry import StereoGeometry
from twin.camera import StereoConfig
from twin.describe import describe_rover
from twin.hardware.emulator.modem import virtual_links
from twin.link import Link
from twin.robot import Robot
from twin.simulation import Simulation

MAP_PLACE, MAP_TURN = 1.7e-3, 4.5e-3
"""Error of the map: deviations of place [m] and turn [rad] along each axis. `ch3-stereo` measured
95th percentiles of 4.8 mm (`camera_error_mm/information/corrected`) and 12.6 mrad
(`frame_turn_mrad`), which are 2.8 deviations of three equal normal axes."""
RATE = 4.0
"""Pairs of images a second (thesis: 3 to 4)."""
NOISE_DB = datasheets.CAMERA.signal_to_noise_db
_FIELD = {"size": (4.8, 4.8), "relief": 0.02, "cell": 0.1, "rocks": 120}


@dataclasses.dataclass(frozen=True)
class InsertionTrial:
    """What one trial is.

    Attributes:
        width: Between the slot's walls [m].
        optimal: Whether the camera is placed optimally, or at random.
        seed: Of field, starts, errors and noise; both placements get the same.
        turn_share: Share of a turn that the slave's skidding leaves, as identified.
        noise_db: Signal-to-noise ratio of the cameras [dB].
        detector: Name of the marker detector.
        fault: Name of a `Fault` that happens; empty for none.
        trace: Keep the course.
    """

    width: float
    optimal: bool
    seed: int
    turn_share: float
    noise_db: float = NOISE_DB
    detector: str = "blob"
    fault: str = ""
    trace: bool = False


@dataclasses.dataclass
class Setting:
    """A trial, ready to run.

    Attributes:
        simulation: Physics.
        robots: Robots as the controllers meet them, with the trial's fault.
        team: Controllers of both robots.
        station: Camera station of the master.
    """

    simulation: Simulation
    robots: Mapping[str, Robot]
    team: InsertionTeam
    station: CameraStation


def prepare(trial: InsertionTrial) -> Setting:
    """Draw where everything stands and what the robots believe of it.

    Args:
        trial: What is tried.
    """
    # The simulation draws its noise from children of the seed itself.
    streams = np.random.default_rng((trial.seed, 1)).spawn(4)
    scene_rng, view_rng, prior_rng, radio_rng = streams
    drawing, master = insertion_drawing(trial.width), describe_rover(MASTER)
    if trial.optimal:
        station = best_station(trial.width)
    else:
        station = random_camera_station(master, drawing, view_rng)
    field = FieldConfig(
        **_FIELD,
        rock_radius=(0.02, 0.05),
        seed=int(scene_rng.integers(2**31)),
        texture_pixels=512,
        texture_tile=0.5,
    )
    beside, ahead, yaw = scene_rng.uniform([-0.03, 0.80, -0.07], [0.03, 0.90, 0.07])
    # The master came by dead reckoning, and knows where it is by the map.
    x, y, heading = np.array(station.place) + 0.01 * scene_rng.normal(size=3)
    scene = InsertionScene(trial.width, (beside, -ahead, yaw), (x, y, heading), field)
    model = compile_insertion(scene)
    marker_guide = _marker_guide(trial, station, settle(model), prior_rng)
    # The camera is placed by the map before the task begins.
    begin_with_camera_at(model, marker_guide.begin(station.angles))
    simulation = Simulation(
        model,
        [MASTER, SLAVE],
        stereo=StereoConfig(RATE, trial.noise_db),
        seed=trial.seed,
        data=settle(model),
    )
    inserter = _inserter(trial, simulation.data, prior_rng)
    slave = describe_rover(SLAVE, card=True)
    sensing = surrogate_sensing(slave, drawing.tip, drawn_springs(slave))
    links: dict[str, Link] = dict(
        virtual_links([MASTER, SLAVE], lambda: simulation.time, radio_rng)
    )
    robots: dict[str, Robot] = dict(simulation.robots)
    if trial.fault:
        fault = FaultInjector(Fault[trial.fault], lambda: inserter.stage, lambda: simulation.time)
        robots, links = fault.robots(robots), fault.links(links)
    team = InsertionTeam(
        InsertionMaster(MASTER, marker_guide, GuidanceLink(links[MASTER])),
        InsertionSlave(SLAVE, inserter, sensing, GuidanceLink(links[SLAVE])),
    )
    return Setting(simulation, robots, team, station)


def _marker_guide(
    trial: InsertionTrial,
    station: CameraStation,
    data: mujoco.MjData,
    rng: np.random.Generator,
) -> MarkerGuide:
    to_robot = transform(data, f"{MASTER}/chassis").inv()
    slot, covariance = _mapped(to_robot * transform(data, "slot"), rng)
    card, _ = _mapped(to_robot * transform(data, f"{SLAVE}/card"), rng)
    master, drawing = describe_rover(MASTER), insertion_drawing(trial.width)
    arm, head = camera_arm(master)
    return MarkerGuide(
        marker_guide_config(master, drawing, trial.optimal, trial.detector),
        arm,
        StereoGeometry(*head.camera.intrinsics, head.baseline),
        (slot, covariance),
        card,
        station.angles,
    )


def _inserter(trial: InsertionTrial, data: mujoco.MjData, rng: np.random.Generator) -> CardInserter:
    slot = transform(data, f"{SLAVE}/chassis").inv() * transform(data, "slot")
    slot, covariance = _mapped(slot, rng)
    steer = rover_steer(trial.turn_share)
    drawing = insertion_drawing(trial.width)
    rover = describe_rover(SLAVE, card=True)
    config = CardInserterConfig(guide_config(drawing, drawn_springs(rover)[0]))
    arm = CardArm(rover, drawing.tip)
    return CardInserter(config, arm, steer, slot.as_matrix(), covariance)


def _mapped(pose: RigidTransform, rng: np.random.Generator) -> tuple[RigidTransform, FloatArray]:
    """Return a pose as the map has it, and its covariance: errors about the pose's own place."""
    deviations = np.array([MAP_TURN] * 3 + [MAP_PLACE] * 3)
    error = RigidTransform.from_exp_coords(deviations * rng.normal(size=6))
    believed = RigidTransform.from_components(
        pose.translation + error.translation, error.rotation * pose.rotation
    )
    place = RigidTransform.from_translation(believed.translation)
    return believed, transport_covariance(place, np.diag(deviations**2))
