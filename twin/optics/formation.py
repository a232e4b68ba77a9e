"""From a rendered image to the light on a camera's sensor."""

import cv2
import numpy as np

from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.pinhole import Pinhole
from twin.optics.blur import Defocus, FloatImage, smear
from twin.optics.flow import Surfaces, confusion
from twin.optics.realism import CameraRealism


class ImageFormation:
    """Defocus, motion blur, vignetting and exposure of one camera.

    Grey levels are proportional to light: the camera's gamma is taken as switched off.

    Args:
        lens: Intrinsics as made.
        realism: Lens and exposure.
        gain: Factor of the light.
    """

    def __init__(self, lens: Pinhole, realism: CameraRealism, gain: float) -> None:
        self._lens, self._realism = lens, realism
        self._light = np.float32(gain) * _vignette(lens, realism.vignetting)
        self._defocus = Defocus(lens.fy / lens.fx) if realism.f_number is not None else None

    def form(self, image: ImageArray, surfaces: Surfaces, flow: FloatArray) -> FloatImage:
        """Return the light (height, width), in grey levels.

        Args:
            image: (height, width) uint8, as a pinhole sees it at the middle of the exposure.
            surfaces: What is to be seen at each block.
            flow: (rows, columns, 2) motion of the image at each block [px/s].
        """
        light = image.astype(np.float32)
        realism = self._realism
        if self._defocus is not None and realism.f_number is not None:
            discs = confusion(self._lens, surfaces, realism.f_number, realism.focus_distance)
            light = self._defocus.apply(light, discs)
        light = smear(light, flow * realism.exposure)
        return np.asarray(cv2.multiply(light, self._light), dtype=np.float32)


def _vignette(lens: Pinhole, falloff: float | None) -> FloatImage:
    """Return the part of the light that reaches each pixel (height, width).

    Args:
        lens: Intrinsics.
        falloff: Part that the corners lose beyond the cos^4 law; None for none and no such law.
    """
    if falloff is None:
        return np.ones((lens.height, lens.width), np.float32)
    rays = lens.rays(lens.pixel_grid())
    square = rays[..., 0] ** 2 + rays[..., 1] ** 2
    # The angle's cosine is 1 / sqrt(1 + square).
    light = (1.0 - falloff * square / square.max()) / (1.0 + square) ** 2
    return light.astype(np.float32)
