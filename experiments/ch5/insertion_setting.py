"""The setting of ``ch5-insertion``: scene, robots, what they believe, and their controllers."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig, InsertionStage
from controllers.insertion.guidance import Guidance, GuidanceError, unpack
from controllers.insertion.guide import GuideConfig
from controllers.insertion.marker_guide import MarkerGuide, MarkerGuideConfig
from controllers.kinematics.chain import Chain
from controllers.sensing.surrogate import SensorLimits, SurrogateSensing
from controllers.sensing.surrogate_tilt import TiltAxis, TiltModel, TiltModelConfig
from controllers.sensing.surrogate_wrench import WrenchModel, WrenchModelConfig
from experiments.ch2.known_arm import known_arm
from experiments.ch3.stereo.mapping_scene import head_geometry
from experiments.ch5.insertion_faults import Fault, FaultyEyes
from experiments.ch5.insertion_identify import rover_springs, rover_steer
from experiments.ch5.insertion_scene import (
    MASTER,
    SLAVE,
    InsertionScene,
    begin_with_camera_at,
    compile_insertion,
    transform,
)
from experiments.ch5.insertion_stand import (
    Stand,
    best_stand,
    card_cad,
    random_stand,
    reference_arm,
    slot_cad,
    watch_plan,
)
from models import datasheets
from models.card_and_slot.stand import TIP
from models.compose import FieldConfig, settle
from models.datasheets import CARD_AND_SLOT, HAND
from perception.geometry.se3 import transport_covariance
from twin.camera import StereoConfig
from twin.hardware.emulator.modem import ModemConfig, VirtualModems
from twin.hardware.radio.framed_radio import FramedLink
from twin.robot import MISSING, Command, Observation
from twin.simulation import Simulation

FloatArray = NDArray[np.float64]

MAP_PLACE, MAP_TURN = 1.7e-3, 4.5e-3
"""Error of the map: deviations of place [m] and turn [rad] along each axis. `ch3-stereo` measured
95th percentiles of 4.8 mm (`camera_error_mm/information/corrected`) and 12.6 mrad
(`frame_turn_mrad`), which are 2.8 deviations of three equal normal axes."""
RATE = 4.0
"""Pairs of images a second (thesis: 3 to 4)."""
NOISE_DB = datasheets.CAMERA.signal_to_noise_db
_FIELD = {"size": (4.8, 4.8), "relief": 0.02, "cell": 0.1, "rocks": 120}
_ABSENT = dict.fromkeys(("accelerometer", "gyro", "heading"), MISSING)
_PREDICTED = 5.0
"""Longest time that a failed sensor is predicted [s]; the tilt's model lasts longer."""


@dataclasses.dataclass(frozen=True)
class InsertionTrial:
    """What one trial is.

    Attributes:
        width: Between the slot's walls [m].
        optimal: Whether the camera is placed optimally, or at random.
        seed: Of field, starts, errors and noise; both placements get the same.
        turn_share: Of the slave's steering, as identified.
        noise_db: Of the cameras.
        detector: Of the markers.
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


class GuidanceRadio:
    """The radio from the master to the slave, with its delay and losses."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Place the modems.

        Args:
            rng: Draws byte errors and sessions.
        """
        self._modems = VirtualModems(ModemConfig(), rng)
        self._links = [FramedLink(end, rng) for end in self._modems.ends]

    def step(self, time: float, guidance: Guidance | None, outage: bool = False) -> list[Guidance]:
        """Send what the master has to say; return what the slave hears.

        Args:
            time: [s].
            guidance: None for nothing new.
            outage: Whether nothing gets through.
        """
        self._modems.time = time
        master, slave = self._links
        if guidance is not None and not outage:
            # What lies out of a message's range was mistaken for card or slot.
            with contextlib.suppress(GuidanceError):
                master.send_latest(guidance.pack())
        master.poll()
        heard = slave.poll().messages
        return [] if outage else [unpack(message) for message in heard]


class InsertionTeam:
    """Both rovers' controllers with the radio between them; each sees itself alone.

    Attributes:
        marker_guide: Of the master.
        inserter: Of the slave.
        failed: Sensors of the slave that are failed now, by its surrogates.
        told: What the master says in this tick; None for nothing new.
    """

    def __init__(
        self,
        marker_guide: MarkerGuide,
        inserter: CardInserter,
        sensing: SurrogateSensing,
        eyes: FaultyEyes,
        rng: np.random.Generator,
    ) -> None:
        """Bring them together.

        Args:
            marker_guide: Of the master.
            inserter: Of the slave.
            sensing: Mends the slave's observations.
            eyes: What goes wrong.
            rng: Draws byte errors and sessions.
        """
        self.marker_guide, self.inserter = marker_guide, inserter
        self.failed: frozenset[str] = frozenset()
        self.told: Guidance | None = None
        self._radio = GuidanceRadio(rng)
        self._sensing, self._eyes = sensing, eyes

    def reset(self) -> None:
        """Nothing is learnt that a new run could not be made for."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Let the master look and tell, and the slave hear and act."""
        stage, period = self.inserter.stage, self.inserter.config.period
        # The thesis' rovers have no accelerometer, gyro or compass.
        bare = {name: seen._replace(**_ABSENT) for name, seen in observations.items()}
        seen = self._eyes.change(bare, stage)
        time = max(each.time for each in seen.values())
        watch, self.told = self.marker_guide.step(seen[MASTER])
        looks = self._radio.step(time, self.told, self._eyes.outage(time, stage))
        inserts = stage is InsertionStage.INSERT
        sensed = self._sensing.step(seen[SLAVE], period, contact=inserts, obstacles=True)
        self.failed = sensed.failed
        if sensed.stop:
            self.inserter.stop(sensed.stop)
        return {MASTER: watch, SLAVE: self.inserter.step(sensed.observation, looks)}


@dataclasses.dataclass
class Setting:
    """A trial, ready to run.

    Attributes:
        simulation: Physics and robots.
        team: Their controllers.
        stand: Of the master.
    """

    simulation: Simulation
    team: InsertionTeam
    stand: Stand


def prepare(trial: InsertionTrial) -> Setting:
    """Draw where everything stands and what the robots believe of it.

    Args:
        trial: What is tried.
    """
    # The simulation draws its noise from children of the seed itself.
    streams = np.random.default_rng((trial.seed, 1)).spawn(4)
    scene_rng, view_rng, prior_rng, radio_rng = streams
    stand = best_stand(trial.width) if trial.optimal else random_stand(trial.width, view_rng)
    field = FieldConfig(
        **_FIELD,
        rock_radius=(0.02, 0.05),
        seed=int(scene_rng.integers(2**31)),
        texture_pixels=512,
        texture_tile=0.5,
    )
    beside, ahead, yaw = scene_rng.uniform([-0.03, 0.80, -0.07], [0.03, 0.90, 0.07])
    # The master came by dead reckoning, and knows where it is by the map.
    x, y, heading = np.array(stand.place) + 0.01 * scene_rng.normal(size=3)
    scene = InsertionScene(trial.width, (beside, -ahead, yaw), (x, y, heading), field)
    model = compile_insertion(scene)
    marker_guide = _marker_guide(trial, stand, settle(model), prior_rng)
    # The camera is placed by the map before the task begins.
    begin_with_camera_at(model, marker_guide.begin(stand.angles))
    simulation = Simulation(
        model,
        [MASTER, SLAVE],
        stereo=StereoConfig(RATE, trial.noise_db),
        seed=trial.seed,
        data=settle(model),
    )
    inserter = _inserter(trial, simulation, prior_rng)
    sensing = surrogate_sensing(model, SLAVE, rover_springs())
    eyes = FaultyEyes(Fault[trial.fault] if trial.fault else None)
    team = InsertionTeam(marker_guide, inserter, sensing, eyes, radio_rng)
    return Setting(simulation, team, stand)


def guide_config() -> GuideConfig:
    """Return what the slave knows of card, friction and itself.

    The wrench is measured half a metre behind the card: the sensor's noise of 0.1 N is 0.05 N m
    there, so the filter is longer and the answers are slower than on the bench of ``ch5-contact``.
    """
    sheet = CARD_AND_SLOT
    return GuideConfig(
        sheet.card_width,
        sheet.friction,
        HAND.stiffness,
        give=0.002,
        give_turn=1.0,
        moment_deadband=0.04,
        filter_time=0.1,
    )


def _marker_guide(
    trial: InsertionTrial, stand: Stand, data: mujoco.MjData, rng: np.random.Generator
) -> MarkerGuide:
    to_robot = transform(data, f"{MASTER}/chassis").inv()
    slot, covariance = _mapped(to_robot * transform(data, "slot"), rng)
    card, _ = _mapped(to_robot * transform(data, f"{SLAVE}/card"), rng)
    config = MarkerGuideConfig(
        card_cad(),
        slot_cad(trial.width),
        CARD_AND_SLOT.marker_diameter,
        watch_plan() if trial.optimal else None,
        trial.detector,
    )
    arm, head = reference_arm(), head_geometry()
    return MarkerGuide(config, arm, head, (slot, covariance), card, stand.angles)


def _inserter(
    trial: InsertionTrial, simulation: Simulation, rng: np.random.Generator
) -> CardInserter:
    data = simulation.data
    slot = transform(data, f"{SLAVE}/chassis").inv() * transform(data, "slot")
    slot, covariance = _mapped(slot, rng)
    steer = rover_steer(trial.turn_share)
    config = CardInserterConfig(guide_config())
    arm = card_arm(simulation.model, SLAVE)
    return CardInserter(config, arm, steer, slot.as_matrix(), covariance)


def card_arm(model: mujoco.MjModel, robot: str) -> CardArm:
    """Return what a robot knows of its arm with the card.

    Args:
        model: A scene with the robot and the card in its gripper.
        robot: Its name.
    """
    known = known_arm(model, robot)
    chain = Chain.of_arm(known, datasheets.ARM_MOTOR.armature)
    return CardArm(reference_arm(), chain, TIP, known.base)


def surrogate_sensing(
    model: mujoco.MjModel, robot: str, springs: tuple[TiltAxis, TiltAxis]
) -> SurrogateSensing:
    """Return what a robot expects its wrench and its inclinometer to be.

    Args:
        model: A scene with the robot and the card in its gripper.
        robot: Its name.
        springs: How it pitches and rolls, as identified.
    """
    rover, motor = datasheets.ROVER, datasheets.ARM_MOTOR
    arm = WrenchModelConfig(
        known_arm(model, robot),
        np.array(rover.arm_mount),
        np.array([0.0, TIP, 0.0]),
        motor.armature,
        friction=np.full(4, motor.friction),
    )
    base = TiltModelConfig(*springs, wheel_radius=rover.wheel_radius)
    sheet = datasheets.FORCE_TORQUE
    noise = np.array([sheet.force_noise] * 3 + [sheet.torque_noise] * 3)
    limits = {
        "arm_base_wrench": SensorLimits(noise, np.array([1.0] * 3 + [0.5] * 3), _PREDICTED),
        "inclinometer": SensorLimits(
            np.full(2, datasheets.INCLINOMETER.noise), np.radians([5.0, 5.0]), 8 * _PREDICTED
        ),
    }
    return SurrogateSensing(WrenchModel(arm), TiltModel(base), limits)


def _mapped(pose: RigidTransform, rng: np.random.Generator) -> tuple[RigidTransform, FloatArray]:
    """Return a pose as the map has it, and its covariance: errors about the pose's own place."""
    deviations = np.array([MAP_TURN] * 3 + [MAP_PLACE] * 3)
    error = RigidTransform.from_exp_coords(deviations * rng.normal(size=6))
    believed = RigidTransform.from_components(
        pose.translation + error.translation, error.rotation * pose.rotation
    )
    place = RigidTransform.from_translation(believed.translation)
    return believed, transport_covariance(place, np.diag(deviations**2))
