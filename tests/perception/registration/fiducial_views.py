"""Random fiducials before two cameras, and how they appear: geometry only."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.registration.reprojection import Sighting
from perception.stereo.geometry import StereoGeometry

HEAD = StereoGeometry(510, 492, 677.34, 871.25, 254.5, 245.5, 0.038)


def random_motion(rng, degrees=3.0, metres=0.03):
    turn, shift = np.radians(degrees) * rng.standard_normal(3), metres * rng.standard_normal(3)
    return RigidTransform.from_exp_coords(np.concatenate([turn, shift]))


def random_points(rng, count, distance=1.1, motion=None):
    """Points (N, 3) in view before and after a motion, within 20 % of a distance."""
    points = []
    while len(points) < count:
        depth = distance * rng.uniform(0.8, 1.2)
        pixel = [rng.uniform(10, 500), rng.uniform(10, 480), HEAD.fx * HEAD.baseline / depth]
        point = HEAD.points(pixel)
        seen = HEAD.project(point if motion is None else motion.apply(point, inverse=True))
        if 0 < seen[0] < HEAD.width and 0 < seen[1] < HEAD.height:
            points.append(point)
    return np.array(points)


def two_views(rng, count, sigma=0.0, distance=1.1):
    """Motion (after to before) and image points before and after, with noise [px]."""
    motion = random_motion(rng)
    points = random_points(rng, count, distance, motion)
    views = (HEAD.project(points), HEAD.project(motion.apply(points, inverse=True)))
    before, after = (view + sigma * rng.standard_normal(view.shape) for view in views)
    return motion, before, after


def error_of(estimate, truth):
    """Exponential coordinates xi with truth = exp(xi) * estimate."""
    return (truth * estimate.inv()).as_exp_coords()


def sighting(image_points, sigma=0.25):
    """Image points (N, 3) as the head sees them, with deviations [px]."""
    return Sighting(image_points, sigma, HEAD)
