"""Observations made by hand."""

import numpy as np

from twin.robot import MISSING, Channel, Observation, Validity

PAIR = np.zeros((2, 4, 6), np.uint8)


def seen_at(
    time: float,
    wheel_speeds: np.ndarray | None = None,
    arm_angles: np.ndarray | None = np.zeros(4),  # noqa: B008
    stereo: np.ndarray | None = None,
    stereo_stamp: float = 0.0,
) -> Observation:
    """Return what a level rover measures; what is None is missing."""

    def channel(value: np.ndarray | None, stamp: float = time) -> Channel:
        return MISSING if value is None else Channel(value, stamp, Validity.MEASURED)

    return Observation(
        time,
        wheel_speeds=channel(np.zeros(4) if wheel_speeds is None else wheel_speeds),
        arm_angles=channel(arm_angles),
        inclinometer=channel(np.zeros(2)),
        stereo=channel(stereo, stereo_stamp),
    )
