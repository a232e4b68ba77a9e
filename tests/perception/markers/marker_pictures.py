"""Pictures of discs, sampled 36 times a pixel: their centres are exact, and no renderer's."""

import numpy as np

from perception.markers.ellipses import project_discs, shape_matrices
from perception.stereo.geometry import StereoGeometry

HEAD = StereoGeometry(510, 492, 677.34, 871.25, 254.5, 245.5, 0.038)
RADIUS = 0.25 * 0.0254 / 2
_SUB = (np.arange(6) + 0.5) / 6 - 0.5


def picture(ellipses, rng, bright=220.0, dark=45.0, plate=14):
    """Return (H, W) uint8: ellipses on dark plates on a textured ground, with noise of 46 dB."""
    coarse, fine = rng.uniform(-30, 30, (41, 43)), rng.uniform(-10, 10, (HEAD.height, HEAD.width))
    image = 95 + np.kron(coarse, np.ones((12, 12)))[: HEAD.height, : HEAD.width] + fine
    for u, v, suu, _, svv in ellipses:
        half = int(max(np.sqrt(suu), np.sqrt(svv))) + plate
        image[int(v) - half : int(v) + half + 1, int(u) - half : int(u) + half + 1] = dark
    for ellipse in ellipses:
        u, v = ellipse[:2]
        inverse = np.linalg.inv(shape_matrices(ellipse))
        y, x = np.mgrid[int(v) - 25 : int(v) + 26, int(u) - 25 : int(u) + 26]
        d = np.stack([x[..., None, None] + _SUB - u + 0 * _SUB[:, None],
                      y[..., None, None] + _SUB[:, None] - v + 0 * _SUB], axis=-1)  # fmt: skip
        inside = np.einsum("...i,ij,...j->...", d, inverse, d) < 1.0
        image[y, x] += (bright - dark) * inside.mean(axis=(2, 3))
    return np.clip(np.rint(image + 1.28 * rng.standard_normal(image.shape)), 0, 255).astype(
        np.uint8
    )


def seen(pose, points, normal=(0, 0, 1)):
    """Return (2, N, 5) ellipses of a body's discs in both images."""
    centres = pose.apply(points)
    eyes = np.stack([centres, centres - [HEAD.baseline, 0, 0]])
    return project_discs(eyes, pose.rotation.apply(normal), RADIUS, HEAD)
