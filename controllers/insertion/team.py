"""The insertion of a card by two rovers: the master looks and tells, the slave hears and acts.

Each robot's part sees its own observations alone; guidance passes by radio (Thesis section 5.1).
"""

from collections.abc import Mapping

import numpy as np

from controllers.insertion.camera_station import camera_arm, watch_plan
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
from twin.description import RobotDescription
from twin.robot import MISSING, Command, Observation

ARM_REACH = 0.4
"""Distance ahead at which the base's give is taken for that of the hand [m]."""
_ABSENT = dict.fromkeys(("accelerometer", "gyro", "heading"), MISSING)
_PREDICTED = 5.0
"""Longest time that a failed sensor is predicted [s]; the tilt's model lasts longer."""


class InsertionMaster:
    """The master's part of an insertion.

    Args:
        robot: Name of the master.
        marker_guide: Its eyes for card and slot.
        link: Its end of the radio.

    Attributes:
        marker_guide: Its eyes for card and slot.
        sent: Guidance of this tick; None for nothing new.
    """

    def __init__(self, robot: str, marker_guide: MarkerGuide, link: GuidanceLink) -> None:
        self.robot, self.marker_guide = robot, marker_guide
        self.sent: Guidance | None = None
        self._link = link

    def step(self, seen: Observation) -> Command:
        """Look, send what is seen, and return the next command.

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
        sensing: Mends the slave's observations.
        link: Its end of the radio.

    Attributes:
        inserter: Brings the card to the slot and inserts it.
        failed: Sensors that are failed now, by their surrogates.
    """

    def __init__(
        self, robot: str, inserter: CardInserter, sensing: SurrogateSensing, link: GuidanceLink
    ) -> None:
        self.robot, self.inserter = robot, inserter
        self.failed: frozenset[str] = frozenset()
        self._sensing, self._link = sensing, link

    def step(self, seen: Observation) -> Command:
        """Hear what the master sees, and return the next command.

        Args:
            seen: Observation of the slave.
        """
        looks, inserter = self._link.receive(), self.inserter
        inserts = inserter.stage is InsertionStage.INSERT
        period = inserter.config.period
        sensed = self._sensing.step(_bare(seen), period, contact=inserts, obstacles=True)
        self.failed = sensed.failed
        if sensed.stop:
            inserter.stop(sensed.stop)
        return inserter.step(sensed.observation, looks)


class InsertionTeam:
    """Both rovers' parts; a `twin.robot.Controller`.

    Args:
        master: The master's part.
        slave: The slave's part.
    """

    def __init__(self, master: InsertionMaster, slave: InsertionSlave) -> None:
        self.master, self.slave = master, slave

    def reset(self) -> None:
        """Nothing is learnt that a new run could not be made for."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Let the master look and tell, and the slave hear and act."""
        parts = (self.master, self.slave)
        return {part.robot: part.step(observations[part.robot]) for part in parts}


def guide_config(drawing: InsertionDrawing, pitch: TiltAxis) -> GuideConfig:
    """Return how force guides a card that a rover's arm holds.

    The wrench is measured half a metre behind the card: the sensor's noise of 0.1 N is 0.05 N m
    there, so the filter is longer and the answers are slower than on the bench of ``ch5-contact``.

    Args:
        drawing: Card and slot.
        pitch: How the rover pitches on its springs: the softest of what holds the card.
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


def marker_guide_config(
    robot: RobotDescription, drawing: InsertionDrawing, placed: bool, detector: str = "blob"
) -> MarkerGuideConfig:
    """Return how a rover looks at card and slot.

    Args:
        robot: The rover that looks.
        drawing: Card and slot.
        placed: Whether it places its camera anew, or leaves it where it is.
        detector: Name in `perception.markers.markers.DETECTORS`.
    """
    plan = watch_plan(camera_arm(robot)[1], drawing) if placed else None
    return MarkerGuideConfig(drawing.card, drawing.slot, drawing.marker_diameter, plan, detector)


def surrogate_sensing(
    robot: RobotDescription, tip: float, springs: tuple[TiltAxis, TiltAxis]
) -> SurrogateSensing:
    """Return what a robot expects its wrench and its inclinometer to be.

    Args:
        robot: The rover with the card in its gripper.
        tip: From the wrist's joint to the middle of the card's leading edge [m].
        springs: How it pitches and rolls.

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
