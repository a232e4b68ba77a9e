"""Configuration of mapping with stereo heads on arms, and the record of each view taken."""

import dataclasses

from controllers.mapping.arm_views import RatedViews, ViewConfig
from controllers.mapping.fiducial_localizer import Correction, FiducialLocalizerConfig
from controllers.mapping.localization import CameraPose, LocalizationConfig
from controllers.mapping.searching import TargetSearchConfig
from perception.geometry.arrays import FloatArray, ImageArray
from perception.stereo.matching import StereoMatcherConfig, StereoPoints

METHODS = ("information", "raster", "random")


@dataclasses.dataclass(frozen=True)
class MapperConfig:
    """Configuration of the motions, views and decisions of mapping robots.

    Attributes:
        method: How the next view is chosen; one of `METHODS`.
        scans: Number of views of each robot, those that search for the target included.
        search_scans: Number of views beyond these for a robot that has not seen the target yet.
        speed: Speed of the fastest joint between views [rad/s].
        rest: Time at the goal before a view is taken [s].
        near: Greatest joint error at which the goal counts as reached [rad].
        patience: Time after which a goal that is not reached is taken as it is [s].
        reach: Nearest and farthest depth that enters the map [m].
        rays: Columns and rows of rays by which a view is rated.
        clear: Radius about the arm's base [m] and least height above it [m] of the space that is
            free when the robot is set down: there the arm may move before it was seen.
        aura: Margin about a robot's spheres that is kept out of the map [m]: robots move.
        search: Configuration of the search for the target.
        views: Configuration of the drawing and rating of candidate views.
        localization: Standard deviations of the camera pose by arm and inclinometer.
        stereo: Configuration of stereo matching.
        localizer: Configuration of the correction of camera poses by fiducials of the scene.
        marker_sigma: (3,) standard deviations of a marker's column, row and disparity [px], as
            measured on 217 markers in 56 rendered views from 0.5 to 1.2 m. Both images err alike,
            for the centre of a disc's image is not the image of its centre.
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
    search: TargetSearchConfig = TargetSearchConfig()
    views: ViewConfig = ViewConfig()
    localization: LocalizationConfig = LocalizationConfig()
    stereo: StereoMatcherConfig = StereoMatcherConfig()
    localizer: FiducialLocalizerConfig = FiducialLocalizerConfig()
    marker_sigma: tuple[float, float, float] = (0.07, 0.07, 0.03)

    def __post_init__(self) -> None:
        """Refuse an unknown method.

        Raises:
            ValueError: Listing the known ones.
        """
        if self.method not in METHODS:
            raise ValueError(f"method {self.method!r}: expected one of {', '.join(METHODS)}")


@dataclasses.dataclass(frozen=True)
class StereoView:
    """One stereo pair, and what was computed from it.

    Attributes:
        robot: Name of the robot that took it.
        number: Index among this robot's views, from 0.
        time: Robot time of the pair [s].
        angles: (joints,) joint angles of the arm [rad].
        pair: (2, H, W) uint8 left and right image.
        points: Matched points, in the left camera's frame.
        prediction: Camera pose by arm and inclinometer; None before the robot was localized.
        correction: Camera pose by the fiducials of the scene as well; None before the robot was
            localized.
        rated: Candidates of the decision that led to this view; None if there was none.
    """

    robot: str
    number: int
    time: float
    angles: FloatArray
    pair: ImageArray
    points: StereoPoints
    prediction: CameraPose | None
    correction: Correction | None
    rated: RatedViews | None
