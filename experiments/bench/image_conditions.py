"""What spoils the images of markers: motion, defocus, exposure, noise, in image space.

All but `LINEARISED` and `EXPOSED` was written down before any run. Grey levels of a rendering are
proportional to radiance; blur acts on them, then the exposure, then the sensor's noise and its
eight bits.
"""

import dataclasses
import math

import numpy as np
from scipy import fft
from scipy.special import j1

from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray, ImageArray

EXPOSED = 0.8
"""White over full scale where nothing is said of the exposure. The renderings' white is full scale,
and there noise and the overshoot of an enlarged image are clipped: it drew tags' corners inward by
0.07 px, which tripled their poses' errors."""
_PAD = 16  # Pixels by which images are continued before they are blurred.


@dataclasses.dataclass(frozen=True)
class Condition:
    """Strength of what spoils an image.

    Attributes:
        name: Name in the metrics' keys.
        motion: Length of the path that an image point takes during the exposure [px].
        defocus: Diameter of the disc that a point becomes [columns]; it is round on the sensor, so
            it is more rows high.
        gain: Exposure: the rendering's white over full scale, before the camera's gamma.
        gamma: Exponent of the camera's response; 1 if grey levels are proportional to radiance.
        noise_db: Full scale over r.m.s. noise [dB].
        linearised: Whether the grey levels are made proportional to radiance again, by the gamma of
            the datasheet, and stretched to full scale, before markers are looked for.
    """

    name: str
    motion: float = 0.0
    defocus: float = 0.0
    gain: float = EXPOSED
    gamma: float = 1.0
    noise_db: float = CAMERA.signal_to_noise_db
    linearised: bool = False

    @property
    def noise(self) -> float:
        """Standard deviation of a pixel's noise [grey levels]."""
        return 255.0 * 10.0 ** (-self.noise_db / 20.0)


CLEAN = Condition("clean")
"""The datasheet's noise alone."""
BLUR = Condition("blur", motion=4.0)
"""A head that sways at 0.35 rad/s, open for a field's 1/60 s: 0.35 / 60 * 677 px = 4 px."""
DEFOCUS = Condition("defocus", defocus=3.0)
"""The 8.5 mm lens at f/2 (assumption), focused at 0.7 m: a disc of 52 um = 4.1 columns at 0.35 m,
19 um = 1.5 columns at 1.1 m; 3 lies between."""
UNDEREXPOSED = Condition("exposure_under", gain=EXPOSED / 4.0, gamma=CAMERA.gamma)
"""Two stops too little light for a fixed exposure, through the camera's gamma (Table D-2)."""
OVEREXPOSED = Condition("exposure_over", gain=EXPOSED * 4.0, gamma=CAMERA.gamma)
"""Two stops too much: what is brighter than 0.31 of white saturates."""
LINEARISED = dataclasses.replace(UNDEREXPOSED, name="under_linearised", linearised=True)
"""The images of `UNDEREXPOSED`, put right by what is known of the camera."""
NOISE = Condition("noise", noise_db=26.0)
"""Automatic gain control turned up by 20 dB in poor light, about the most that such cameras add."""
CONDITIONS = (CLEAN, BLUR, DEFOCUS, UNDEREXPOSED, OVEREXPOSED, LINEARISED, NOISE)


def motion_transfer(frequencies: FloatArray, length: float, angle: float) -> FloatArray:
    """Return by how much a straight path of an image point passes spatial frequencies.

    Args:
        frequencies: (..., 2) along columns and rows [1/px].
        length: Length of the path [px].
        angle: Direction of the path, from the columns' towards growing rows [rad].
    """
    return np.sinc(length * (frequencies @ [math.cos(angle), math.sin(angle)]))


def disc_transfer(frequencies: FloatArray, diameter: float, stretch: float) -> FloatArray:
    """Return by how much a disc of defocus passes spatial frequencies.

    Args:
        frequencies: (..., 2) along columns and rows [1/px].
        diameter: Diameter of the disc [columns].
        stretch: Rows of the disc over its columns.
    """
    x = math.pi * diameter * np.hypot(frequencies[..., 0], stretch * frequencies[..., 1])
    return np.where(x > 1e-9, 2.0 * j1(x) / np.maximum(x, 1e-9), 1.0)


def blurred(images: FloatArray, condition: Condition, direction: float) -> FloatArray:
    """Return images (N, H, W) after motion and defocus, which act exactly, between pixels too.

    Args:
        images: (N, H, W) grey levels.
        condition: Lengths of the blur.
        direction: Direction of the motion, from the columns' towards growing rows [rad].
    """
    if condition.motion == 0.0 and condition.defocus == 0.0:
        return images
    # The transform is periodic: what is beyond an edge continues it.
    padded = np.pad(images, ((0, 0), (_PAD, _PAD), (_PAD, _PAD)), mode="edge")
    height, width = padded.shape[1:]
    rows, columns = np.meshgrid(fft.fftfreq(height), fft.rfftfreq(width), indexing="ij")
    frequencies = np.stack([columns, rows], axis=-1)
    pinhole = CAMERA.pinhole
    transfer = motion_transfer(frequencies, condition.motion, direction)
    transfer *= disc_transfer(frequencies, condition.defocus, pinhole.fy / pinhole.fx)
    spread = fft.irfft2(fft.rfft2(padded) * transfer, s=(height, width))
    return spread[:, _PAD:-_PAD, _PAD:-_PAD]


def take(
    exact: FloatArray, condition: Condition, direction: float, rng: np.random.Generator
) -> ImageArray:
    """Return images as a camera takes them under a condition.

    Args:
        exact: (N, H, W) grey levels without noise, 0 to 255, proportional to radiance.
        condition: Strength of what spoils them.
        direction: Direction of the motion blur, from the columns' towards growing rows [rad].
        rng: Random generator for the noise.

    Returns:
        (N, H, W) uint8.
    """
    light = condition.gain * blurred(exact, condition, direction) / 255.0
    levels = 255.0 * np.clip(light, 0.0, 1.0) ** condition.gamma
    levels += condition.noise * rng.standard_normal(levels.shape)
    taken = np.clip(np.rint(levels), 0, 255)
    if condition.linearised:
        light = (taken / 255.0) ** (1.0 / condition.gamma)
        taken = np.rint(255.0 * light / light.max())
    return taken.astype(np.uint8)
