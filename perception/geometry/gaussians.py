"""Gaussians in space whose covariance is packed as xx, xy, xz, yy, yz, zz, for kernels."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from perception.voxels.raycast import KERNEL

FloatArray = NDArray[np.float64]


@numba.njit(**KERNEL)
def merge(
    mean: FloatArray, covariance: FloatArray, other_mean: FloatArray, other_covariance: FloatArray
) -> None:
    """Merge two Gaussians in place: C1 - C1 (C1 + C2)^-1 C1 (Thesis eq. 3-8 and 3-10, mended).

    Args:
        mean: (3,) changed.
        covariance: (6,) xx, xy, xz, yy, yz, zz; changed.
        other_mean: (3,).
        other_covariance: (6,).
    """
    a, b, c = covariance[0], covariance[1], covariance[2]
    d, e, f = covariance[3], covariance[4], covariance[5]
    sa, sb, sc = a + other_covariance[0], b + other_covariance[1], c + other_covariance[2]
    sd, se, sf = d + other_covariance[3], e + other_covariance[4], f + other_covariance[5]
    ia, ib, ic = sd * sf - se * se, sc * se - sb * sf, sb * se - sc * sd
    scale = 1.0 / (sa * ia + sb * ib + sc * ic)
    ia, ib, ic = ia * scale, ib * scale, ic * scale
    id_, ie = (sa * sf - sc * sc) * scale, (sb * sc - sa * se) * scale
    if_ = (sa * sd - sb * sb) * scale
    k00, k01, k02 = a * ia + b * ib + c * ic, a * ib + b * id_ + c * ie, a * ic + b * ie + c * if_
    k10, k11, k12 = b * ia + d * ib + e * ic, b * ib + d * id_ + e * ie, b * ic + d * ie + e * if_
    k20, k21, k22 = c * ia + e * ib + f * ic, c * ib + e * id_ + f * ie, c * ic + e * ie + f * if_
    x, y, z = other_mean[0] - mean[0], other_mean[1] - mean[1], other_mean[2] - mean[2]
    mean[0] += k00 * x + k01 * y + k02 * z
    mean[1] += k10 * x + k11 * y + k12 * z
    mean[2] += k20 * x + k21 * y + k22 * z
    covariance[0] = a - (k00 * a + k01 * b + k02 * c)
    covariance[1] = b - (k00 * b + k01 * d + k02 * e)
    covariance[2] = c - (k00 * c + k01 * e + k02 * f)
    covariance[3] = d - (k10 * b + k11 * d + k12 * e)
    covariance[4] = e - (k10 * c + k11 * e + k12 * f)
    covariance[5] = f - (k20 * c + k21 * e + k22 * f)


@numba.njit(**KERNEL)
def copy(
    mean: FloatArray, covariance: FloatArray, from_mean: FloatArray, from_covariance: FloatArray
) -> None:
    """Overwrite a Gaussian by another."""
    for axis in range(3):
        mean[axis] = from_mean[axis]
    for k in range(6):
        covariance[k] = from_covariance[k]


@numba.njit(**KERNEL)
def variance_along(covariance: FloatArray, x: float, y: float, z: float) -> float:
    """Return the variance in a direction."""
    diagonal = x * x * covariance[0] + y * y * covariance[3] + z * z * covariance[5]
    return diagonal + 2.0 * (x * y * covariance[1] + x * z * covariance[2] + y * z * covariance[4])
