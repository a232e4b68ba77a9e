"""How robots map with stereo heads on their arms, and what each of their looks was."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.arm_views import RatedViews, ViewConfig
from controllers.mapping.localiser import Correction, LocaliserConfig
from controllers.mapping.localization import CameraPose, LocalizationConfig
from controllers.mapping.searching import SearchConfig
from perception.stereo.matching import StereoMatcherConfig, StereoPoints

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.uint8]

METHODS = ("information", "raster", "random")


@dataclasses.dataclass(frozen=True)
class MapperConfig:
    """How the robots move, look and choose.

    Attributes:
        method: One of `METHODS`.
        scans: Looks of each robot, those for the target included.
        search_scans: Looks beyond these of a robot that has not seen the target yet.
        speed: Fastest joint on the way to a view [rad/s].
        rest: Time at the goal before a look [s].
        near: Greatest joint error at which the arm counts as there [rad].
        patience: Longest time at a goal that is not reached [s].
        reach: Nearest and farthest depth that enters the map [m].
        rays: Columns and rows of rays by which a view is rated.
        clear: Radius about the arm's base [m] and least height above it [m] of the space that is
            free when the robot is set down: there the arm may move before it was seen.
        aura: Kept out of the map about a robot, beside its own size [m]: robots move.
        search: How the target is looked for.
        views: How views are drawn and rated.
        standing: How well arm and inclinometer tell where the camera is.
        stereo: How pairs are matched.
        localiser: How fiducials of the scene correct the camera's pose.
        marker_sigma: (3,) deviations of a marker's column, row and disparity [px]: as measured on
            217 markers in 56 rendered views from 0.5 to 1.2 m. The place errs alike in both images,
            for the middle of a disc's picture is not the picture of its middle.
    """

    method: str = "information"
    scans: int = 12
    search_scans: int = 0
    speed: float = 0.8
    rest: float = 0.6
    near: float = 0.05
    patience: float = 4.0
    reach: tuple[float, float] = (0.25, 2.0)
    rays: tuple[int, int] = (40, 40)
    clear: tuple[float, float] = (0.55, -0.02)
    aura: float = 0.03
    search: SearchConfig = SearchConfig()
    views: ViewConfig = ViewConfig()
    standing: LocalizationConfig = LocalizationConfig()
    stereo: StereoMatcherConfig = StereoMatcherConfig()
    localiser: LocaliserConfig = LocaliserConfig()
    marker_sigma: tuple[float, float, float] = (0.07, 0.07, 0.03)

    def __post_init__(self) -> None:
        """Refuse an unknown method.

        Raises:
            ValueError: Listing the known ones.
        """
        if self.method not in METHODS:
            raise ValueError(f"method {self.method!r}: expected one of {', '.join(METHODS)}")


@dataclasses.dataclass(frozen=True)
class RobotBrief:
    """What is known of a robot beforehand.

    Attributes:
        arm: Its kinematics.
        home: (joints,) where its arm starts [rad].
        body: (K, 4) spheres that cover the rest of it, centre and radius [m], robot frame.
    """

    arm: SerialChain
    home: FloatArray
    body: FloatArray


@dataclasses.dataclass(frozen=True)
class Look:
    """One stereo pair and what became of it.

    Attributes:
        robot: Whose.
        number: Counts this robot's looks from 0.
        time: Robot time of the pair [s].
        angles: (joints,) of the arm [rad].
        pair: (2, H, W) uint8.
        seen: Points in the left camera.
        guess: Where arm and inclinometer put the camera; None before the robot knew its place.
        correction: What the fiducials of the scene said of it.
        rated: Candidates of the decision that led here; None if there was none.
    """

    robot: str
    number: int
    time: float
    angles: FloatArray
    pair: ImageArray
    seen: StereoPoints
    guess: CameraPose | None
    correction: Correction | None
    rated: RatedViews | None
