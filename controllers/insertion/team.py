"""Insertion of a card by two rovers: the master sends guidance, the slave moves the card.

Each robot's part uses its own observations alone; guidance is sent by radio (Thesis section 5.1).
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
from controllers.insertion.seating import SeatingConfig
from controllers.insertion.watching import Surroundings
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
"""Distance ahead of the base at which its compliance acts on the hand [m]."""
_ABSENT = dict.fromkeys(("accelerometer", "gyro", "heading"), MISSING)
_PREDICTED = 5.0
"""Longest time that a failed wrench sensor is predicted [s]; the tilt's model holds longer."""


class InsertionMaster:
    """The master's part of an insertion.

    Args:
        robot: Name of the master.
        marker_guide: Measurement of card and slot, and motion of the camera.
        link: The robot's end of the radio.

    Attributes:
        marker_guide: Measurement of card and slot, and motion of the camera.
        sent: Guidance sent in this tick; None without a new one.
    """

    def __init__(self, robot: str, marker_guide: MarkerGuide, link: GuidanceLink) -> None:
        self.robot, self.marker_guide = robot, marker_guide
        self.sent: Guidance | None = None
        self._link = link

    def step(self, seen: Observation) -> Command:
        """Process an observation, send guidance, and return the next command.

        Args:
            seen: Observation of the master.
        """
        command, self.sent = self.marker_guide.step(_bare(seen))
        self._link.send(self.sent, seen.time)
        return command


class InsertionSlave:
    """The slave's part of an insertion.

    Args:
        robot: Name of the slave.
        inserter: Control of wheels and arm during the insertion.
        sensing: Surrogates of the slave's failed sensors.
        link: The robot's end of the radio.

    Attributes:
        inserter: Control of wheels and arm during the insertion.
        failed: Names of the sensors that are found failed now.
    """

    def __init__(
        self, robot: str, inserter: CardInserter, sensing: SurrogateSensing, link: GuidanceLink
    ) -> None:
        self.robot, self.inserter = robot, inserter
        self.failed: frozenset[str] = frozenset()
        self._sensing, self._link = sensing, link

    def step(self, seen: Observation) -> Command:
        """Process an observation and the master's guidance, and return the next command.

        Args:
            seen: Observation of the slave.
        """
        views, inserter = self._link.receive(seen.time), self.inserter
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
        """Do nothing: each run has a new team."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Step the master, then the slave."""
        parts = (self.master, self.slave)
        return {part.robot: part.step(observations[part.robot]) for part in parts}


def guide_config(drawing: InsertionDrawing, pitch: TiltAxis) -> GuideConfig:
    """Return the configuration of force guidance for a card in a rover's gripper.

    The wrench is measured half a metre behind the card: the sensor's noise of 0.1 N is 0.05 N m
    there, so the filter is longer and the response slower than on the bench of ``ch5-contact``.

    Args:
        drawing: Drawing of card and slot.
        pitch: Pitch dynamics of the rover, the softest part of the card's support.
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


def seating_config(drawing: InsertionDrawing) -> SeatingConfig | None:
    """Return what seats a card in its connector, as it is drawn; None for a slot without one.

    Args:
        drawing: Drawing of card and slot.
    """
    connector = drawing.connector
    if connector is None:
        return None
    return SeatingConfig(connector.depth, connector.snap, connector.mouth, speed=0.0015)


def marker_guide(
    robot: RobotDescription,
    drawing: InsertionDrawing,
    slot: tuple[RigidTransform, FloatArray],
    card: RigidTransform,
    angles: FloatArray,
    placed: bool,
    detector: str = "blob",
    about: Surroundings | None = None,
) -> MarkerGuide:
    """Return the master's guide, which measures card and slot.

    Args:
        robot: Description of the rover with the camera.
        drawing: Drawing of card and slot.
        slot: Prior transform from the slot to the robot, and its covariance (6, 6).
        card: Approximate transform from the card to the robot.
        angles: (4,) initial joint angles [rad].
        placed: Whether the camera moves to its best view, or keeps its pose.
        detector: Name of the marker detector, in `perception.markers.bodies.DETECTORS`.
        about: What stands about card and slot, robot frame; None for nothing.
    """
    arm, head = camera_arm(robot)
    plan = watch_plan(head, drawing) if placed else None
    config = MarkerGuideConfig(
        drawing.card,
        drawing.slot,
        drawing.marker_diameter,
        plan,
        detector,
        exposure=head.exposure,
    )
    return MarkerGuide(config, arm, stereo_geometry(robot), slot, card, angles, about)


def surrogate_sensing(
    robot: RobotDescription, tip: float, springs: tuple[TiltAxis, TiltAxis]
) -> SurrogateSensing:
    """Return the surrogates of a robot's wrench sensor and inclinometer.

    Args:
        robot: Description of the rover with the card in its gripper.
        tip: Distance from the wrist's joint to the middle of the card's leading edge [m].
        springs: Pitch and roll dynamics.

    Raises:
        ValueError: If the robot has no arm, naming it.
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
    """Return an observation without sensors that the thesis' rovers lack: inertial and compass."""
    return seen._replace(**_ABSENT)
