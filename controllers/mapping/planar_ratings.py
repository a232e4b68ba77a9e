"""What a planar view is worth: the thesis' rating function, and distance at its going rate.

The thesis rates a view by RF = (NI - K (d/D)^n)(1 - P) (eq. 3-15, with the distance over the depth
of field D so that K has no unit). A constant K is a constant price of a metre. That suits one world
only: indoors, where views are half hidden, the same K buys mere slivers of what is near.

The price of a metre should be what the metre could earn elsewhere: K = max V / (d + s), the best
information by distance on offer, where s is the path that a scan is worth. With n = 1 the best view
then is the one with the greatest V / (d + s): the rule has no scale of its own, so it serves both
worlds alike. V is NI with unknown cells amid known ones worth more: to come back for them later
costs a trip of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]


def fixed_price_rating(
    information: FloatArray,
    distance: FloatArray,
    probability: FloatArray,
    price: float,
    exponent: float,
) -> FloatArray:
    """Rate views by Thesis eq. 3-15, a fixed price of distance.

    (1 - P) multiplies positive ratings only: it would raise a negative one of an occupied cell.

    Args:
        information: (n, headings) NI.
        distance: (n,) length of the path there over the depth of field, d / D.
        probability: (n,) P that the pose is occupied.
        price: K.
        exponent: n.

    Returns:
        (n, headings) ratings.
    """
    rating = information - price * distance[:, None] ** exponent
    return np.where(rating > 0.0, rating * (1.0 - probability[:, None]), rating)


def rate_rating(
    information: FloatArray, distance: FloatArray, probability: FloatArray, scan_path: float
) -> FloatArray:
    """Rate views by information over path and time, NI (1 - P) / (d / D + s / D).

    Args:
        information: (n, headings) NI or a weighted one.
        distance: (n,) length of the path there over the depth of field, d / D.
        probability: (n,) P that the pose is occupied.
        scan_path: Path that a scan is worth over the depth of field, s / D = v t_scan / D.

    Returns:
        (n, headings) ratings.
    """
    return information * ((1.0 - probability) / (distance + scan_path))[:, None]


def isolation_weights(known: BoolArray, width: int, gain: float) -> FloatArray:
    """Return how much more cells are worth that known ones surround.

    Args:
        known: (rows, columns) cells that were measured; outside the map all counts as known.
        width: Side of the square neighbourhood [cells], made odd.
        gain: What a cell amid known ones only is worth more.

    Returns:
        (rows, columns) 1 + gain * share of known cells around.
    """
    share = ndimage.uniform_filter(known.astype(float), width | 1, mode="constant", cval=1.0)
    return 1.0 + gain * np.clip(share, 0.0, 1.0)
