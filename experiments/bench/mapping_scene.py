"""A scene of analytic shapes, seen by a noisy range camera: mapping with a truth in closed form."""

import dataclasses

import numpy as np
from scipy.spatial.transform import RigidTransform

from experiments.ch3.stereo.scene import HEAD, PIXEL_SIGMA, look_at
from perception.geometry.arrays import FloatArray

WIDTH, HEIGHT = 320, 240
MAX_DEPTH = 1.6
"""Points farther away are left out [m], as a stereo rig does."""
GROUND = 0.0033
"""Height of the ground [m]: inside a voxel, not on a face, where its voxel would be a toss."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """Ground at z = GROUND with spheres and upright boxes on it.

    Attributes:
        spheres: (n, 4) centre and radius [m].
        boxes: (m, 6) lower and upper corner [m].
    """

    spheres: FloatArray
    boxes: FloatArray

    @classmethod
    def random(cls, generator: np.random.Generator, radius: float = 0.45) -> "Scene":
        """Scatter four spheres and four boxes around the origin.

        Args:
            generator: Source of randomness.
            radius: Radius of the disc that holds their centres [m].
        """
        where = _in_disc(generator, 8, radius)
        size = generator.uniform(0.04, 0.12, 4)
        spheres = np.column_stack([where[:4], 0.7 * size, size])
        half = generator.uniform(0.03, 0.12, (4, 2))
        tall = generator.uniform(0.05, 0.3, (4, 1))
        low = np.column_stack([where[4:] - half, np.zeros(4)])
        return cls(spheres, np.hstack([low, where[4:] + half, tall]))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the signed distance of points to the nearest surface [m], negative inside.

        Args:
            points: (N, 3) [m].
        """
        nearest = points[:, 2] - GROUND
        for *centre, radius in self.spheres:
            nearest = np.minimum(nearest, np.linalg.norm(points - centre, axis=1) - radius)
        for box in self.boxes:
            beyond = np.abs(points - (box[:3] + box[3:]) / 2) - (box[3:] - box[:3]) / 2
            outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
            nearest = np.minimum(nearest, outside + np.minimum(beyond.max(axis=1), 0.0))
        return nearest

    def cast(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Return how far along each ray the first surface is, in lengths of the direction.

        Args:
            origin: (3,) [m].
            directions: (N, 3).

        Returns:
            (N,), infinite where there is none.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            ground = (GROUND - origin[2]) / directions[:, 2]
            nearest = np.where(ground > 0.0, ground, np.inf)
            for *centre, radius in self.spheres:
                offset = origin - centre
                a = np.sum(directions**2, axis=1)
                b = directions @ offset
                root = np.sqrt(b * b - a * (offset @ offset - radius**2))
                hit = (-b - root) / a
                nearest = np.where(hit > 0.0, np.minimum(nearest, hit), nearest)
            for box in self.boxes:
                sides = np.stack([(box[:3] - origin) / directions, (box[3:] - origin) / directions])
                enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
                hit = (enter > 0.0) & (enter <= leave)
                nearest = np.where(hit, np.minimum(nearest, enter), nearest)
        return nearest


@dataclasses.dataclass(frozen=True)
class Cloud:
    """What one view gives.

    Attributes:
        transform_camera_to_world: Where the camera stood.
        points: (N, 3) measured [m], world.
        covariances: (N, 3, 3) [m^2], world.
        truth: (N, 3) where the rays really met a surface [m], world.
    """

    transform_camera_to_world: RigidTransform
    points: FloatArray
    covariances: FloatArray
    truth: FloatArray


def random_view(generator: np.random.Generator) -> RigidTransform:
    """Return a view of the scene's middle from a ring around it."""
    angle = generator.uniform(0.0, 2.0 * np.pi)
    radius, height = generator.uniform(0.8, 1.05), generator.uniform(0.4, 0.8)
    position = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
    target = np.append(_in_disc(generator, 1, 0.2)[0], 0.05)
    return look_at(position, target)


def see(scene: Scene, pose: RigidTransform, generator: np.random.Generator) -> Cloud:
    """Return a cloud of at most 320 x 240 points with the noise that the stereo head has.

    The points are every so many pixels of the head's image, over its whole field of view.

    Args:
        scene: What is seen.
        pose: Camera to world.
        generator: Source of the noise.
    """
    rays = HEAD.rays(HEAD.pixel_grid(WIDTH, HEIGHT)).reshape(-1, 3)
    depth = scene.cast(pose.translation, pose.rotation.apply(rays))
    seen = depth < MAX_DEPTH
    true = rays[seen] * depth[seen, None]
    sigma = np.array(PIXEL_SIGMA)
    noisy = HEAD.points(HEAD.project(true) + sigma * generator.standard_normal(true.shape))
    turn = pose.rotation.as_matrix()
    covariances = np.ascontiguousarray(turn @ HEAD.covariance(noisy, sigma) @ turn.T)
    points = np.ascontiguousarray(pose.apply(noisy))
    return Cloud(pose, points, covariances, pose.apply(true))


def _in_disc(generator: np.random.Generator, count: int, radius: float) -> FloatArray:
    angle = generator.uniform(0.0, 2.0 * np.pi, count)
    length = radius * np.sqrt(generator.uniform(0.0, 1.0, count))
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])
