"""Pictures on which appendix C's methods are measured, and what is measured of each.

They are all pictures bundled with scikit-image that have at least 256 pixels each way, and views
rendered in the field of chapter 3. Each is taken whole, as grey levels, and averaged to size.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import skimage
from PIL import Image

from perception.compression.byte_codes import entropy, mean_word_length
from perception.compression.image_codec import (
    CODERS,
    METHODS,
    Coder,
    coded_bits,
    compress,
    decompress,
)
from perception.compression.image_predictors import PREDICTORS, residuals
from perception.geometry.arrays import ByteArray, FloatArray

SIZES = (16, 32, 64, 128, 256)
"""Edges of the square pictures [px]."""
DRAWINGS = frozenset({"color.png", "horse.png", "logo.png", "phantom.png"})
"""Bundled pictures that no camera took."""
TWINS = frozenset({"motorcycle_right.png"})
"""Left out: a stereo partner shows what another picture shows."""
BLUR = 1.0
"""Deviation of the blur that takes the noise from a picture [px at 256]."""
_ENDINGS = (".jpg", ".png")


@dataclasses.dataclass(frozen=True)
class Measured:
    """What is measured of pictures at each of `SIZES`; S sizes, N pictures.

    Attributes:
        ratios: (S, N, 10) compression ratios by method, of Shannon entropies.
        coded: (S, N, 10, coders) bytes of a picture over those of its file, by method and coder;
            NaN where the method has another coder.
        round_trips: Number of round trips made.
        failures: Number of round trips that did not give the picture back.
        outside: Huffman codes of residuals whose mean word is not within [H, H + 1] bit.
    """

    ratios: FloatArray
    coded: FloatArray
    round_trips: int
    failures: int
    outside: int

    @classmethod
    def joined(cls, parts: "Sequence[Measured]") -> "Measured":
        """Return all pictures of several measurements."""
        return cls(
            np.concatenate([part.ratios for part in parts], axis=1),
            np.concatenate([part.coded for part in parts], axis=1),
            sum(part.round_trips for part in parts),
            sum(part.failures for part in parts),
            sum(part.outside for part in parts),
        )

    def some(self, which: Sequence[int]) -> "Measured":
        """Return the ratios of some of the pictures; what was counted stays with the whole."""
        index = list(which)
        return Measured(self.ratios[:, index], self.coded[:, index], 0, 0, 0)


@dataclasses.dataclass(frozen=True)
class NoiseTrial:
    """Pictures of noise; a job of the sweep.

    Attributes:
        seed: Seed of the noise.
        count: Number of pictures of each size.
    """

    seed: int
    count: int


def bundled_pictures() -> Mapping[str, ByteArray]:
    """Return scikit-image's own pictures by file name, (H, W) uint8; nothing is downloaded."""
    folder = Path(skimage.__file__).parent / "data"
    found: dict[str, ByteArray] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix not in _ENDINGS or path.name in TWINS:
            continue
        with Image.open(path) as picture:
            if min(picture.size) >= max(SIZES):
                found[path.name] = np.asarray(picture.convert("L"))
    return found


def resampled(image: ByteArray, size: int) -> ByteArray:
    """Return a whole picture (H, W) averaged to a square (size, size)."""
    return np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


def smoothed(image: ByteArray) -> ByteArray:
    """Return a picture without its finest detail, and so without its noise."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), BLUR), np.uint8)


def noise(size: int, rng: np.random.Generator) -> ByteArray:
    """Return a picture (size, size) of pure noise: all grey levels are as likely."""
    return rng.integers(0, 256, (size, size), dtype=np.uint8)


def ratios(image: ByteArray) -> FloatArray:
    """Return (10,) compression ratios by method; see `perception.compression.image_codec`."""
    before = entropy(image)
    return np.array([before / max(coded_bits(image, method), 1e-12) for method in METHODS])


def measure(pictures: Sequence[Sequence[ByteArray]]) -> Measured:
    """Return what every method makes of pictures, and whether each gives them back.

    Args:
        pictures: (H, W) each, as many for each of `SIZES`.
    """
    fit = [[ratios(picture) for picture in of_size] for of_size in pictures]
    tries = [[_round_trips(picture) for picture in of_size] for of_size in pictures]
    coded = np.array([[file for file, _ in of_size] for of_size in tries])
    failures = sum(failed for of_size in tries for _, failed in of_size)
    outside = sum(_outside(picture) for of_size in pictures for picture in of_size)
    return Measured(np.array(fit), coded, int(np.isfinite(coded).sum()), failures, outside)


def measure_whole(images: Iterable[ByteArray]) -> Measured:
    """Return `measure` of whole pictures (H, W), averaged to each of `SIZES`."""
    listed = list(images)
    return measure([[resampled(image, size) for image in listed] for size in SIZES])


def measure_noise(trial: NoiseTrial) -> Measured:
    """Return `measure` of pictures of noise; a job of the sweep."""
    rng = np.random.default_rng((trial.seed, 8))
    pictures = [[noise(size, rng) for _ in range(trial.count)] for size in SIZES]
    return measure(pictures)


def _round_trips(image: ByteArray) -> tuple[FloatArray, int]:
    """Return (10, coders) bytes of a picture over those of its file, and failed round trips."""
    coded = np.full((len(METHODS), len(CODERS)), np.nan)
    failures = 0
    for row, method in enumerate(METHODS):
        coders: tuple[Coder, ...] = CODERS if method in PREDICTORS else ("huffman",)
        for coder in coders:
            file = compress(image, method, coder)
            coded[row, CODERS.index(coder)] = image.size / len(file)
            failures += not np.array_equal(decompress(file), image)
    return coded, failures


def _outside(image: ByteArray) -> int:
    """Count Huffman codes of residuals that are shorter than the entropy or a bit longer."""
    count = 0
    for method in PREDICTORS:
        left = residuals(image, method)
        bits, word = entropy(left), mean_word_length(left)
        count += not bits - 1e-9 <= word <= bits + 1.0
    return count
