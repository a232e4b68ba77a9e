"""A slave without physics: it rolls and moves as commanded, and its card touches what is said.

On springs it tilts under its arm, at once.
"""

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.card_arm import CardArm, inverse, to_plane
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig
from controllers.insertion.guidance import Guidance
from controllers.insertion.team import guide_config
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.base_tilt import BaseTilt, drawn_springs
from controllers.motion.driving import SkidSteer
from experiments.ch5.insertion_scene import SLAVE
from models import datasheets
from models.card_and_slot.stand import CARD_AXES, SLOT_HEIGHT
from tests.controllers.insertion.scenes import DRAWING, card_arm, scene
from twin.describe import describe, describe_rover
from twin.robot import ArmMode, Channel, Command, Observation, Validity, WheelMode

PERIOD = 0.01
STEER = SkidSteer(datasheets.ROVER.wheel_radius, datasheets.ROVER.half_track, 0.7)
SLOT = np.eye(4)
SLOT[:3, :3], SLOT[:3, 3] = CARD_AXES, [0.0, 0.0, SLOT_HEIGHT]
PRIOR = np.diag([4.5e-3**2] * 3 + [1.7e-3**2] * 3)
LOOK = np.diag([2e-3**2] * 3 + [3e-4**2] * 3)


def config(**changes) -> CardInserterConfig:
    """Return how the slave moves."""
    return dataclasses.replace(
        CardInserterConfig(guide_config(DRAWING, drawn_springs(describe_rover(SLAVE))[0])),
        **changes,
    )


class Slave:
    """Rolls on a plane by commands.

    Attributes:
        place: x, y [m] and yaw [rad] of its chassis.
        angles: (4,) of its arm [rad].
        push: (6,) by the world on the card, card frame [N, N m].
        commands: All so far.
    """

    def __init__(
        self, start=(0.02, -0.85, 0.04), slip: float = 1.0, springs: BaseTilt | None = None
    ):
        self.arm: CardArm = card_arm()
        self.place = np.array(start, dtype=float)
        self.angles = np.array(datasheets.ARM.home)
        self.push = np.zeros(6)
        self.commands: list[Command] = []
        self.time = 0.0
        self._chain = SerialChain.of_robot(describe(scene()[0], SLAVE))
        self._slip, self._springs = slip, springs
        self._speeds, self._rates = np.zeros(4), np.zeros(4)

    def robot(self) -> np.ndarray:
        """Return (4, 4) from the chassis to the world."""
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("z", self.place[2]).as_matrix()
        pose[:3, 3] = [*self.place[:2], datasheets.ROVER.centre_height]
        if self._springs is not None:
            pose = pose @ self._springs.motion(self._tilt()).as_matrix()
        return pose

    def _tilt(self) -> np.ndarray:
        """Return (2,) its pitch and roll relative to those with the arm at home [rad]."""
        if self._springs is None:
            return np.zeros(2)
        up = np.array([0.0, 0.0, 1.0])
        home = self.arm.weight(np.array(datasheets.ARM.home), up)
        return self._springs.tilt(self.arm.weight(self.angles, up) - home)

    def card_in_slot(self) -> np.ndarray:
        """Return (4, 4), true."""
        return inverse(SLOT) @ self.robot() @ self.arm.card_frame(self.angles)

    def error(self) -> np.ndarray:
        """Return (5,) `to_plane` of the card in the slot."""
        return to_plane(self.card_in_slot())

    def inserter(self, error=None, base: BaseTilt | None = None, **changes) -> CardInserter:
        """Return its controller, with the map's error (6,) in its own frame.

        What it feeds forward of its springs is `base`.
        """
        slot = RigidTransform.from_matrix(inverse(self.robot()) @ SLOT)
        wrong = RigidTransform.from_exp_coords(np.zeros(6) if error is None else error)
        believed = wrong * slot
        return CardInserter(config(**changes), self.arm, STEER, believed, PRIOR, base)

    def look(self) -> Guidance:
        """Return what the master sees now, without error."""
        pose = RigidTransform.from_matrix(inverse(self.card_in_slot()))
        return Guidance(self.time, True, True, pose, LOOK)

    def observe(self) -> Observation:
        """Return what it measures, without noise; the wrench is that of a level robot."""
        held = self._chain.inverse_dynamics(self.angles, np.zeros(4), np.zeros(4))[1]
        card = self.arm.card_frame(self.angles)
        lever = card[:3, 3] - self._base()
        force, moment = card[:3, :3] @ self.push[:3], card[:3, :3] @ self.push[3:]
        outside = np.concatenate([force, moment + np.cross(lever, force)])
        return Observation(
            self.time,
            wheel_speeds=self._channel(self._speeds),
            arm_angles=self._channel(self.angles),
            arm_rates=self._channel(self._rates),
            inclinometer=self._channel(self._tilt()),
            arm_base_wrench=self._channel(held - outside),
        )

    def drive(self, command: Command) -> None:
        """Do what is commanded for a tick."""
        self.commands.append(command)
        self.time += PERIOD
        moves = command.wheel_mode is WheelMode.SPEED
        self._speeds = np.array(command.wheels) if moves else np.zeros(4)
        forward, turn = STEER.motion(self._speeds)
        forward, turn = self._slip * forward, self._slip * turn
        middle = self.place[2] + 0.5 * turn * PERIOD
        way = forward * PERIOD
        self.place += [-way * math.sin(middle), way * math.cos(middle), turn * PERIOD]
        if command.arm_mode is ArmMode.POSITION:
            self._rates = (command.arm - self.angles) / PERIOD
            self.angles = np.array(command.arm)

    def run(self, inserter: CardInserter, seconds: float, looks: bool = True, until=None) -> None:
        """Let a controller drive it; a look each quarter of a second, a tenth late."""
        late: list[Guidance] = []
        for tick in range(round(seconds / PERIOD)):
            if looks and tick % 25 == 0:
                late.append(self.look())
            heard = late if tick % 25 == 10 else []
            self.drive(inserter.step(self.observe(), heard))
            if heard:
                late = []
            if until is not None and until():
                return

    def stands_still(self, ticks: int) -> bool:
        """Say whether the last commands moved nothing."""
        last = self.commands[-ticks:]
        arms = np.array([c.arm for c in last])
        wheels = np.array([c.wheels for c in last])
        rates = np.array([c.arm_rates for c in last])
        return bool(np.all(arms == arms[0]) and not wheels.any() and not rates.any())

    def _base(self) -> np.ndarray:
        return np.asarray(datasheets.ROVER.arm_mount, dtype=float)

    def _channel(self, value) -> Channel:
        return Channel(np.array(value, dtype=float), self.time, Validity.MEASURED)
