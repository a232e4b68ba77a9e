"""Ground of a scene: noise textures, height field, rocks, blocks and friction, all from a seed.

Points are in the world frame, z up, the field centred on the origin; lengths in metres.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.clutter import NO_SOLIDS, Solids
from models.ground_friction import FrictionMap
from perception.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class Terrain:
    """Heights on a regular grid, and the rocks, blocks and screens on it.

    Attributes:
        size: (2,) lengths along x and y [m].
        heights: (rows, columns) [m]; row 0 lies at the smallest y. Flat ground has (2, 2) zeros.
        rocks: Ellipsoids on the ground.
        blocks: Boxes on the ground.
        screens: Upright boxes at chosen places.
        friction: Coulomb coefficients between tyres and the ground; None where they are the tyres'
            own.
    """

    size: tuple[float, float]
    heights: FloatArray
    rocks: Solids = NO_SOLIDS
    blocks: Solids = NO_SOLIDS
    screens: Solids = NO_SOLIDS
    friction: FrictionMap | None = None

    @property
    def is_flat(self) -> bool:
        """True when no height field is needed below the rocks."""
        return not np.any(self.heights)

    def ground_at(self, points: ArrayLike) -> FloatArray:
        """Return the height of the bare ground, bilinear between the grid's nodes.

        Args:
            points: (..., 2) [m], world; points outside the field get its border's height.

        Returns:
            (...) heights [m].
        """
        points = np.asarray(points, dtype=float)
        rows, columns = self.heights.shape
        u = np.clip((points[..., 0] / self.size[0] + 0.5) * (columns - 1), 0, columns - 1)
        v = np.clip((points[..., 1] / self.size[1] + 0.5) * (rows - 1), 0, rows - 1)
        i = np.minimum(u.astype(int), columns - 2)
        j = np.minimum(v.astype(int), rows - 2)
        s, t = u - i, v - j
        low = self.heights[j, i] * (1 - s) + self.heights[j, i + 1] * s
        high = self.heights[j + 1, i] * (1 - s) + self.heights[j + 1, i + 1] * s
        return low * (1 - t) + high * t

    def height_at(self, points: ArrayLike) -> FloatArray:
        """Return the height of the surface, rocks, blocks and screens included.

        Args:
            points: (..., 2) [m], world.

        Returns:
            (...) heights [m].
        """
        places = np.asarray(points, dtype=float)
        flat = places.reshape(-1, 2)
        heights = self.ground_at(flat)
        for height, axes, index, (along, across) in self.rocks.above(flat):
            inside = 1.0 - (along / axes[0]) ** 2 - (across / axes[1]) ** 2
            top = height + axes[2] * np.sqrt(np.maximum(inside, 0.0))
            heights[index] = np.where(inside > 0.0, np.maximum(heights[index], top), heights[index])
        for boxes in (self.blocks, self.screens):
            for height, half, index, (along, across) in boxes.above(flat):
                under = index[(np.abs(along) <= half[0]) & (np.abs(across) <= half[1])]
                heights[under] = np.maximum(heights[under], height + half[2])
        return heights.reshape(places.shape[:-1])

    def rise_at(self, points: ArrayLike) -> FloatArray:
        """Return by how much the surface stands out of the bare ground.

        Args:
            points: (..., 2) [m], world.

        Returns:
            (...) heights [m]; 0 where neither rock, block nor screen is.
        """
        return self.height_at(points) - self.ground_at(points)

    def friction_at(self, points: ArrayLike) -> FloatArray:
        """Return the Coulomb coefficients between tyres and the ground.

        Args:
            points: (..., 2) [m], world; points outside the field get its border's friction.

        Returns:
            (...) coefficients.

        Raises:
            ValueError: If the field leaves them to the tyres.
        """
        if self.friction is None:
            raise ValueError("the field has no friction of its own: each robot's tyres decide")
        return self.friction.at(points)


def noise_image(
    rng: np.random.Generator, pixels: int, octaves: int, exponent: float = 1.0
) -> FloatArray:
    """Return seamless noise with equal weight for each octave at ``exponent`` 1.

    Args:
        rng: Source of randomness.
        pixels: Width and height of the square tile.
        octaves: Number of octaves kept, counted up from one period a tile.
        exponent: Amplitude falls with frequency to this power.

    Returns:
        (pixels, pixels) with zero mean and unit variance, periodic in both directions.
    """
    spectrum = np.fft.rfft2(rng.standard_normal((pixels, pixels)))
    rows = np.fft.fftfreq(pixels) * pixels
    columns = np.fft.rfftfreq(pixels) * pixels
    radius = np.hypot(rows[:, None], columns[None, :])
    keep = (radius >= 1.0) & (radius <= 2.0**octaves)
    spectrum *= np.where(keep, np.maximum(radius, 1.0) ** -exponent, 0.0)
    image = np.fft.irfft2(spectrum, s=(pixels, pixels))
    return (image - image.mean()) / image.std()


SAND = (1.0, 0.94, 0.84)
"""Colour of ground and rocks."""
BLOCK = (1.0, 0.80, 0.62)
"""Colour of blocks and screens."""
PANEL = (0.62, 0.72, 1.0)
"""Colour of the panel's face."""


def noise_texture(
    rng: np.random.Generator, pixels: int, tint: tuple[float, float, float] = SAND
) -> NDArray[np.uint8]:
    """Return a tile whose detail reaches down to two pixels, so that stereo can match it.

    Args:
        rng: Source of randomness.
        pixels: Width and height; a power of two.
        tint: Red, green and blue of its brightest spot.

    Returns:
        (pixels, pixels, 3) uint8 RGB.
    """
    grey = noise_image(rng, pixels, octaves=int(np.log2(pixels)) - 1)
    level = np.clip(0.52 + 0.17 * grey, 0.02, 0.98)
    return np.round(255.0 * level[..., None] * np.array(tint)).astype(np.uint8)


def make_heights(
    rng: np.random.Generator, size: tuple[float, float], relief: float, cell: float
) -> FloatArray:
    """Return rolling ground: equal noise in each octave from the field's size down to 0.4 m.

    Args:
        rng: Source of randomness.
        size: (2,) [m].
        relief: Standard deviation of the height [m]; 0 gives flat ground.
        cell: Spacing of the grid [m].

    Returns:
        (rows, columns) heights [m].
    """
    if relief == 0.0:
        return np.zeros((2, 2))
    longest = max(size)
    pixels = int(round(longest / cell)) + 1
    octaves = max(1, int(np.floor(np.log2(longest / 0.4))))
    tile = noise_image(rng, pixels, octaves)
    rows, columns = (int(round(length / cell)) + 1 for length in (size[1], size[0]))
    return relief * tile[:rows, :columns]


def make_rocks(
    rng: np.random.Generator,
    terrain: Terrain,
    count: int,
    radius: tuple[float, float],
    clear: FloatArray,
) -> Solids:
    """Strew rocks over a terrain.

    Args:
        rng: Source of randomness.
        terrain: Ground to set them in.
        count: Number of rocks drawn; those in a cleared disc are left out.
        radius: Smallest and largest horizontal semi-axis [m]; small ones are more frequent.
        clear: (N, 3) discs without rocks: x and y of the centre, and radius [m].

    Returns:
        The rocks, each protruding from the ground by 0.3 to 0.7 of its mean horizontal semi-axis.
    """
    half = np.asarray(terrain.size) / 2.0
    places = rng.uniform(-half, half, (count, 2))
    low, high = radius
    mean = low * (high / low) ** rng.uniform(0.0, 1.0, count)
    aspect = rng.uniform(0.8, 1.25, count)
    upright = mean * rng.uniform(0.6, 1.0, count)
    out = mean * rng.uniform(0.3, 0.7, count)
    yaws = rng.uniform(-np.pi, np.pi, count)
    axes = np.column_stack([mean * aspect, mean / aspect, upright])
    heights = terrain.ground_at(places) + np.minimum(out, upright) - upright
    centres = np.column_stack([places, heights])
    keep = np.ones(count, dtype=bool)
    for x, y, gap in clear:
        keep &= np.hypot(*(places - (x, y)).T) > gap + axes[:, :2].max(axis=1)
    return Solids(centres[keep], axes[keep], yaws[keep])
