"""Configuration of mapping with stereo heads on arms, and the record of each view taken."""

import dataclasses
from collections.abc import Mapping

from controllers.mapping.arm_views import RatedViews, ViewConfig
from controllers.mapping.fiducial_localizer import Correction, FiducialLocalizerConfig
from controllers.mapping.localization import CameraPose, LocalizationConfig
from controllers.mapping.searching import TargetSearchConfig
from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.checks import check_choice
from perception.stereo.matching import StereoMatcherConfig, StereoPoints

METHODS = ("information", "raster", "random")


@dataclasses.dataclass(frozen=True)
class MapperConfig:
    """Configuration of the motions, views and decisions of mapping robots.

    Attributes:
        method: Method that chooses the next view; one of `METHODS`.
        scans: Number of views of each robot, those that search for the target included.
        search_scans: Number of further views of a robot that has not detected the target yet.
        speed: Speed of the fastest joint between views [rad/s].
        rest: Time at the goal before a view is taken [s].
        near: Greatest joint error at which the goal counts as reached [rad].
        patience: Time after which a view is taken although its goal is not reached [s].
        reach: Nearest and farthest depth that enters the map [m].
        rays: Columns and rows of rays that rate a view.
        clear: Radius about the arm's base [m] and least height above it [m] of the space that is
            free at the robot's start: there the arm may move before the space is mapped.
        aura: Margin about a robot's spheres that is excluded from the map [m]: robots move.
        search: Configuration of the search for the target.
        views: Configuration of the drawing and rating of candidate views.
        localization: Standard deviations of the camera pose by arm and inclinometer.
        stereo: Configuration of stereo matching.
        localizer: Configuration of the correction of camera poses by fiducials of the scene.
        marker_sigma: (3,) standard deviations of a marker's column, row and disparity [px], as
            measured on 217 markers in 56 rendered views from 0.5 to 1.2 m. The errors of both
            images are correlated: the centre of a disc's image is not the image of its centre.
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
        check_choice("method", self.method, METHODS)


@dataclasses.dataclass(frozen=True)
class StereoView:
    """One stereo pair, and its results.

    Attributes:
        robot: Name of the robot.
        number: Index among this robot's views, from 0.
        time: Robot time of the pair [s].
        angles: (joints,) joint angles of the arm [rad].
        tilt: (2,) pitch and roll of the robot [rad].
        arms: (joints,) angles of the robots' arms by name, where known [rad].
        pair: (2, H, W) uint8 left and right image.
        points: Matched points, in the left camera's frame.
        rated: Candidates of the decision that led to this view; None if there was none.
        prediction: Camera pose by arm and inclinometer; None before the robot was localized.
        correction: Camera pose by the fiducials of the scene as well; None before the robot was
            localized.
    """

    robot: str
    number: int
    time: float
    angles: FloatArray
    tilt: FloatArray
    arms: Mapping[str, FloatArray]
    pair: ImageArray
    points: StereoPoints
    rated: RatedViews | None
    prediction: CameraPose | None = None
    correction: Correction | None = None
