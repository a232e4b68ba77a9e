"""What drawings and data sheets leave unknown of a rover's arm and its sensors, for controllers.

Tolerances and largest errors are of all such robots; what was drawn for one of them is never used.
"""

import math

import numpy as np

from controllers.identification.arm_deviations import ArmDeviations
from models.datasheets import FORCE_TORQUE
from twin.optics.realism import RealismName
from twin.realism import realism_of

_UNIFORM = 1.0 / math.sqrt(3.0)
"""Standard deviation over the largest error of what is uniform to either side."""


def arm_deviations(realism: RealismName) -> ArmDeviations | None:
    """Return what is unknown of an arm and its sensors; None if they are as drawn.

    Args:
        realism: How far the robot and its sensors are from their drawings.
    """
    named = realism_of(realism)
    tolerances, errors = named.tolerances, named.sensor_errors
    if tolerances is None or errors is None:
        return None
    loads = np.array(FORCE_TORQUE.full_scale)
    matrix = errors.wrench_cross * loads[:, None] / loads
    np.fill_diagonal(matrix, errors.wrench_scale)
    least, most = (play / 2.0 for play in tolerances.backlash)
    return ArmDeviations(
        mass=_UNIFORM * tolerances.mass,
        centre=_UNIFORM * tolerances.centre,
        length=_UNIFORM * tolerances.length,
        encoder=_UNIFORM * errors.encoder_zero,
        play=_UNIFORM * (most - least) / 2.0,
        usual_play=(most + least) / 2.0,
        tilt=_UNIFORM * errors.inclinometer_zero,
        zero=_UNIFORM * errors.wrench_zero * loads,
        drift=_UNIFORM * errors.wrench_drift * loads,
        warm_up=errors.wrench_warm_up,
        matrix=_UNIFORM * matrix,
    )
