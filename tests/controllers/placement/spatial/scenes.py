"""Random scenes in space, and what they hide by brute force."""

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from controllers.placement.task import Lens, Occluder, PlacementError, Target

LENS = Lens(field_of_view=0.72, pixels=510, near=0.127, far=0.6)


def disc_target(
    name="hole", position=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), radius=0.01, points=8
):
    """A flat regular polygon."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    side = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    turn = 2.0 * np.pi * np.arange(points) / points
    outline = radius * (
        np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(normal, side)
    )
    return Target(name, np.asarray(position, float), normal, outline)


def box(name, centre, half, turn=None):
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
    turn = turn or Rotation.identity()
    return Occluder(name, turn.apply(corners) + centre)


def random_occluders(rng, count, target):
    """Boxes and random polytopes about a target, none nearer to it than twice its radius."""
    reach = np.linalg.norm(target.outline, axis=1).max()
    found = []
    while len(found) < count:
        place = rng.uniform(-0.35, 0.35, 3)
        size = rng.uniform(0.01, 0.1)
        name = f"block {len(found)}"
        if rng.random() < 0.5:
            made = box(name, place, size * rng.uniform(0.3, 1.0, 3), Rotation.random(rng=rng))
        else:
            made = Occluder(name, place + size * rng.uniform(-1.0, 1.0, (8, 3)))
        made = Occluder(name, made.points + target.position)
        equations = ConvexHull(made.points).equations
        if np.max(equations[:, :3] @ target.position + equations[:, 3]) > 2.0 * reach:
            found.append(made)
    return found


def fibonacci(count):
    """(count, 3) even directions; no gap is wider than about 3.6 / sqrt(count) rad."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + 5.0**0.5) * index
    flat = np.sqrt(1.0 - z * z)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def hidden(field, directions, radius):
    """Whether the segment from target to each camera meets any hull, by clipping with planes."""
    result = directions @ field.target.normal <= 0.0
    for shape in field.shapes:
        planes = ConvexHull(shape).equations
        offset = planes[:, :3] @ field.target.position + planes[:, 3]
        slope = directions @ planes[:, :3].T
        with np.errstate(divide="ignore"):
            at = -offset / slope
        enter = np.max(np.where(slope < 0, at, 0.0), axis=1)
        leave = np.min(np.where(slope > 0, at, np.inf), axis=1)
        result |= np.maximum(enter, 0.0) <= np.minimum(leave, radius)
    return result


__all__ = [
    "LENS",
    "PlacementError",
    "box",
    "disc_target",
    "fibonacci",
    "hidden",
    "random_occluders",
]
