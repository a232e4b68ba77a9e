"""Mapping: the choice of the next view, for planar robots and for stereo heads on arms (chapter 3).

Stereo heads on arms, in reading order:

- `stereo_mapper`: the controller that moves all robots from view to view.
- `stereo_view`: its configuration, and the record of each view.
- `searching`: the search for the target, and aiming the camera at a point (3.2.2).
- `localization`: a robot's pose from the target, and its camera's pose and covariance (3.2.2).
- `shared_map`: the robots' common voxel map, and the fusion of views (3.2.3).
- `arm_views`: candidates for the next view and their rating (3.2.4).
- `fiducial_localizer`: camera poses corrected by fiducials of the scene (3.2.5).

On the way:

- `visual_odometry`: a rover's pose from pair to pair, by features and by its wheels.
- `panel_search`: where the target may be, and which view is worth its time.

Planar robots (3.3.1):

- `planar_planner`: the choice of the next pose by seven methods, for one robot or a team.
- `planar_situation`: a planner's estimate of the map, candidates and frontiers.
- `planar_paths`: shortest paths on known-free cells.

Rovers over mapped ground:

- `ground_paths`: where a rover may be, and its paths, from an elevation map.

Exchange by radio:

- `messages`: poses and wrenches packed into bytes.
- `pose_sharing`: a rover that shares its dead reckoning and its wrench.
- `map_sharing`: two robots' elevation maps, shared tile by tile within a budget of bytes.
"""

from typing import Literal, TypeAlias, get_args

Method: TypeAlias = Literal[
    "random", "raster", "max_new", "min_old", "information", "frontier", "rate"
]
METHODS: tuple[Method, ...] = get_args(Method)
"""Names of the methods of planar robots, apart from what they do: options need no more."""
