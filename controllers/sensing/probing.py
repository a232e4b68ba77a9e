"""The motion that tells most of a change that was named: gentle, and back where it began.

What was named was seen for seconds. Its size is told better by what moves the part that changed: a
joint that swings, or wheels that turn the rover to and fro and drive it. Of base, springs and tyres
turning tells most, as tyres slide then: far more than driving straight on does.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from controllers.sensing.diagnosis import UNKNOWN, Finding
from controllers.sensing.loose_camera import LOOSE_CAMERA
from twin.description import RobotDescription

PERIOD = 4.0
"""Time of one motion to and fro [s]."""
SHARE = 0.6
"""Largest share of the speeds of a person's hand."""
_HOLDING = "elbow"  # Joint whose swing tells of a load in the gripper, more than the shoulder's.


class Asked(NamedTuple):
    """What is asked of a rover, as `controllers.motion.teleoperation.Teleoperation.ask` takes it.

    Attributes:
        ahead: Speed ahead, -1 to 1 of the largest.
        left: Turning to the left, -1 to 1 of the largest.
        arm: (joints,) rates of the arm's joints, -1 to 1 of the largest.
    """

    ahead: float
    left: float
    arm: Sequence[float]


def probes(finding: Finding) -> bool:
    """Return whether there is a motion that tells more of a change.

    Of one that is not known none does, and of a camera a pair of images tells all.
    """
    return finding.name not in (UNKNOWN, LOOSE_CAMERA)


def probe(finding: Finding, robot: RobotDescription, time: float) -> Asked:
    """Return what is asked of a rover at a time of the motion.

    A joint goes to one side and back in a period, to the other in the next; wheels turn in one, and
    drive in the next. It may end at any time.

    Args:
        finding: A change that a detector named, of those of `twin.shadow.deviations`.
        robot: The rover as drawn.
        time: Since the motion began [s].

    Raises:
        ValueError: If nothing tells more of it.
    """
    if not probes(finding):
        raise ValueError(f"{finding.name}: no motion tells more of it")
    part = _HOLDING if finding.name == "load gripper" else finding.name.partition(" ")[2]
    joints = list(robot.joint_names)
    index, phase = divmod(time, PERIOD)
    wave = SHARE * math.sin(2.0 * math.pi * phase / PERIOD)
    even, arm = index % 2 == 0, np.zeros(len(joints))
    if part in joints:
        arm[joints.index(part)] = wave if even else -wave
        return Asked(0.0, 0.0, arm.tolist())
    return Asked(*((0.0, wave) if even else (wave, 0.0)), arm.tolist())
