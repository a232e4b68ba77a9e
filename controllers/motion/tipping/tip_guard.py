"""A guard of what a rover does in the field: moves of its arm, and drives on slopes.

The zero-moment point knows neither springs nor the free centre joint: with the arm over the lower
wheels across a slope of 28 degrees it is 5 cm inside the footprint of a rover that is likely to tip
over. So a move that it allows is also looked at ahead, which takes 0.2 s while the rover stands,
and as often again where it is slowed further and further and then refused.
"""

import numpy as np

from controllers.kinematics.rigid_motion import FrameMotion
from controllers.motion.base_motion import level_of
from controllers.motion.tipping.look_ahead import PERIOD, LookAhead, Plan, slow
from controllers.motion.tipping.tip_over import Footing, Guarded, Sweep, guard
from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription
from twin.robot import Observation

HORIZON = 2.0
"""How far a drive is looked at ahead [s]."""
LIKELY = 0.4
"""Probability to tip over from which on a drive is stopped."""


class TipGuard:
    """Guards one rover against tipping over.

    Each look draws the same copies of the rover, so that two differ by what is planned alone.

    Args:
        robot: Description of the rover, with an arm, and four wheels on springs.
        seed: Random seed of the copies.

    Attributes:
        footing: The rover as its zero-moment point sees it.

    Raises:
        ValueError: If the rover has no arm, or not four wheels on springs.
    """

    def __init__(self, robot: RobotDescription, seed: int = 0) -> None:
        self._ahead, self._seed = LookAhead(robot), seed
        self._radius = robot.wheel_radius
        self.footing = Footing.of(robot)

    def allowed(self, sweep: Sweep, still: FrameMotion) -> Guarded:
        """Return a move as it may be made, or none.

        It is slowed or cut short by its zero-moment point, and then slowed until it tips the rover
        over with `look_ahead.CHANCE` at most.

        Args:
            sweep: Requested move of the arm, the wheels at rest.
            still: The base at rest, as its inclinometer has it.
        """
        found = guard(self.footing, sweep, still)
        if found.sweep is None:
            return found
        slower = slow(self._ahead, found.sweep, self._rng(), still)
        return slower if slower.report else found

    def warning(self, seen: Observation, wheels: FloatArray) -> str:
        """Return what a drive is likely to do to the rover within `HORIZON`; empty if nothing.

        Args:
            seen: Observation of the rover, with its arm's angles, its tilt and its gyro; without
                that it is taken not to turn yet.
            wheels: (4,) speeds at which its wheels turn and go on [rad/s], in the order of
                `WHEELS`.
        """
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        rims = self._radius * wheels[:2]
        turn = float(seen.gyro.value[2]) if seen.gyro.usable else 0.0
        commanded = np.tile(rims, (round(HORIZON / PERIOD), 1))
        plan = Plan.of_drive(angles, commanded, rims, turn)
        chance = self._ahead.outlook(plan, self._rng(), level_of(seen)).tip()
        return f"tips over within {HORIZON:g} s with {chance:.0%}" if chance > LIKELY else ""

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(self._seed)
