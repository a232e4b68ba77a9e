"""Stage ``map``, chapter 3: both rovers map the site; each ignores cells claimed by the other."""

import numpy as np

from controllers.insertion.camera_station import camera_arm
from controllers.mapping.localization import RobotLocalization, arm_errors, tilt_to_level
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import MapperConfig
from controllers.mission.belief import MissionBelief
from controllers.mission.exchange import ArmPosture, Exchange
from controllers.motion.arm_move import ArmMove
from perception.geometry.se3 import composed_covariance
from twin.description import RobotDescription
from twin.robot import Command, Observation


class MapTogether:
    """Drives one robot's arm through its views of the common map.

    Args:
        belief: Estimates of the robot.
        exchange: Message exchange between the robots, with the common map.
    """

    name = "map"

    def __init__(self, belief: MissionBelief, exchange: Exchange) -> None:
        assert exchange.mapper is not None
        self._robot, self._exchange, self.mapper = belief.robot.name, exchange, exchange.mapper
        self._rest = ArmMove(belief.home)

    @classmethod
    def begin(
        cls,
        belief: MissionBelief,
        partner: RobotDescription,
        exchange: Exchange,
        scans: int,
        rng: np.random.Generator,
    ) -> "MapTogether":
        """Return the stage in which both robots continue one robot's map.

        Args:
            belief: Estimates of the robot that began the map.
            partner: Description of the other robot; it takes part if its pose was measured.
            exchange: Message exchange between the robots; gets the common map.
            scans: Number of views of each robot.
            rng: Random generator for candidate views.
        """
        assert belief.map is not None and belief.localization is not None
        robots = {belief.robot.name: belief.robot}
        places = {belief.robot.name: belief.localization}
        if belief.partner.met:
            robots[partner.name] = partner
            places[partner.name] = _partner_place(belief, belief.localization, partner)
        config = MapperConfig(scans=scans)
        exchange.mapper = StereoMapper(robots, belief.map, config, rng, localizations=places)
        return cls(belief, exchange)

    @property
    def done(self) -> bool:
        """Whether all robots have taken their views."""
        return self.mapper.done

    def step(self, seen: Observation) -> Command:
        """Return the command towards the next view, or home if the robot takes no part."""
        if self._robot not in self.mapper.localizations:
            return self._rest.command(seen)
        arms = {
            name: posture.angles
            for name in self.mapper.localizations
            if (posture := self._exchange.read(name, ArmPosture)) is not None
            and posture.angles is not None
        }
        return self.mapper.step_robot(self._robot, seen, arms)


def _partner_place(
    belief: MissionBelief, here: RobotLocalization, partner: RobotDescription
) -> RobotLocalization:
    """Return the partner's localization on the map, from the views of its card."""
    assert partner.arm is not None
    arm, pose = camera_arm(partner)[0], belief.partner
    to_world = here.transform_level_to_world * belief.transform_slot_to_level
    there = to_world * pose.transform_slot_to_robot.inv()
    covariance = composed_covariance(there, here.robot_covariance(), pose.covariance)
    level = there * tilt_to_level(pose.tilt).inv()
    by_arm = arm_errors(arm, partner.arm.home, pose.tilt, level)
    by_arm[:, :6] = 0.0  # Its card was seen, not what its head sees: the joints' errors cancel.
    return RobotLocalization(arm, level, covariance, by_arm, here.config)
