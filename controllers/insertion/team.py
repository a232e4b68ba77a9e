"""The insertion of a card by two rovers: the master sends what it sees, the slave acts on it.

Each robot's part sees its own observations alone; guidance passes by radio (Thesis section 5.1).
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm, stereo_geometry, watch_plan
from controllers.insertion.card_inserter import CardInserter, InsertionStage
from controllers.insertion.drawing import InsertionDrawing
from controllers.insertion.guidance import Guidance, GuidanceLink
from controllers.insertion.guide import GuideConfig
from controllers.insertion.marker_guide import MarkerGuide, MarkerGuideConfig
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.base_tilt import TiltAxis
from controllers.sensing.surrogate import SensorLimits, SurrogateSensing
from controllers.sensing.surrogate_models import (
    TiltModel,
    TiltModelConfig,
    WrenchModel,
    WrenchModelConfig,
)
from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription
from twin.robot import MISSING, Command, Observation

ARM_REACH = 0.4
"""Distance ahead at which the base's compliance is taken for that of the hand [m]."""
_ABSENT = dict.fromkeys(("accelerometer", "gyro", "heading"), MISSING)
_PREDICTED = 5.0
"""Longest time that a failed sensor is predicted [s]; the tilt's model lasts longer."""


class InsertionMaster:
    """The master's part of an insertion.

    Args:
        robot: Name of the master.
        marker_guide: Guide that sees card and slot.
        link: The robot's end of the radio.

    Attributes:
        marker_guide: Guide that sees card and slot.
        sent: Guidance of this tick; None without a new one.
    """

    def __init__(self, robot: str, marker_guide: MarkerGuide, link: GuidanceLink) -> None:
        self.robot, self.marker_guide = robot, marker_guide
        self.sent: Guidance | None = None
        self._link = link

    def step(self, seen: Observation) -> Command:
        """Take a view, send what it shows, and return the next command.

        Args:
            seen: Observation of the master.
        """
        command, self.sent = self.marker_guide.step(_bare(seen))
        self._link.send(self.sent)
        return command


class InsertionSlave:
    """The slave's part of an insertion.

    Args:
        robot: Name of the slave.
        inserter: Brings the card to the slot and inserts it.
        sensing: Replaces failed sensors of the slave by surrogates.
        link: The robot's end of the radio.

    Attributes:
        inserter: Brings the card to the slot and inserts it.
        failed: Names of the sensors that their surrogates find failed now.
    """

    def __init__(
        self, robot: str, inserter: CardInserter, sensing: SurrogateSensing, link: GuidanceLink
    ) -> None:
        self.robot, self.inserter = robot, inserter
        self.failed: frozenset[str] = frozenset()
        self._sensing, self._link = sensing, link

    def step(self, seen: Observation) -> Command:
        """Take the master's guidance, and return the next command.

        Args:
            seen: Observation of the slave.
        """
        views, inserter = self._link.receive(), self.inserter
        period, inserts = inserter.config.period, inserter.stage is InsertionStage.INSERT
        sensed = self._sensing.step(_bare(seen), period, contact=inserts, obstacles=True)
        self.failed = sensed.failed
        if sensed.stop:
            inserter.stop(sensed.stop)
        return inserter.step(sensed.observation, views)


class InsertionTeam:
    """Both rovers' parts; a `twin.robot.Controller`.

    Args:
        master: The master's part.
        slave: The slave's part.
    """

    def __init__(self, master: InsertionMaster, slave: InsertionSlave) -> None:
        self.master, self.slave = master, slave

    def reset(self) -> None:
        """Do nothing: a new run gets a new team."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Step the master, then the slave."""
        parts = (self.master, self.slave)
        return {part.robot: part.step(observations[part.robot]) for part in parts}


def guide_config(drawing: InsertionDrawing, pitch: TiltAxis) -> GuideConfig:
    """Return the configuration of force guidance for a card that a rover's arm holds.

    The wrench is measured half a metre behind the card: the sensor's noise of 0.1 N is 0.05 N m
    there, so the filter is longer and the answers are slower than on the bench of ``ch5-contact``.

    Args:
        drawing: Card and slot as drawn.
        pitch: Pitch dynamics of the rover, the softest of what holds the card.
    """
    return GuideConfig(
        drawing.card_width,
        drawing.friction,
        pitch.stiffness / ARM_REACH**2,
        give=0.002,
        give_turn=1.0,
        moment_deadband=0.04,
        filter_time=0.1,
    )


def marker_guide(
    robot: RobotDescription,
    drawing: InsertionDrawing,
    slot: tuple[RigidTransform, FloatArray],
    card: RigidTransform,
    angles: FloatArray,
    placed: bool,
    detector: str = "blob",
) -> MarkerGuide:
    """Return the guide of a rover that sees card and slot.

    Args:
        robot: The rover with the camera.
        drawing: Card and slot as drawn.
        slot: Prior transform from the slot to the robot, and its covariance (6, 6).
        card: Rough transform from the card to the robot.
        angles: (4,) joint angles at which the camera begins [rad].
        placed: Whether the camera is placed anew, or left where it is.
        detector: Name in `perception.markers.bodies.DETECTORS`.
    """
    arm, head = camera_arm(robot)
    plan = watch_plan(head, drawing) if placed else None
    config = MarkerGuideConfig(drawing.card, drawing.slot, drawing.marker_diameter, plan, detector)
    return MarkerGuide(config, arm, stereo_geometry(robot), slot, card, angles)


def surrogate_sensing(
    robot: RobotDescription, tip: float, springs: tuple[TiltAxis, TiltAxis]
) -> SurrogateSensing:
    """Return the surrogates of a robot's wrench sensor and inclinometer.

    Args:
        robot: The rover with the card in its gripper.
        tip: Distance from the wrist's joint to the middle of the card's leading edge [m].
        springs: Pitch and roll dynamics.

    Raises:
        ValueError: If it has no arm, naming it.
    """
    chain, sigma = SerialChain.of_robot(robot), robot.sensor_sigma
    arm = WrenchModelConfig(
        chain,
        np.asarray(chain.transform_base_to_robot.translation),
        np.array([0.0, tip, 0.0]),
    )
    base = TiltModelConfig(*springs, wheel_radius=robot.wheel_radius)
    limits = {
        "arm_base_wrench": SensorLimits(
            sigma["arm_base_wrench"], np.array([1.0] * 3 + [0.5] * 3), _PREDICTED
        ),
        "inclinometer": SensorLimits(
            np.full(2, sigma["inclinometer"]), np.radians([5.0, 5.0]), 8 * _PREDICTED
        ),
    }
    return SurrogateSensing(WrenchModel(arm), TiltModel(base), limits)


def _bare(seen: Observation) -> Observation:
    """Return an observation as the thesis' rovers have it: no accelerometer, gyro or compass."""
    return seen._replace(**_ABSENT)
