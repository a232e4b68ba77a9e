"""Residuals against the thesis' equations, pixel by pixel, and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from perception.compression.image_predictors import PREDICTORS, residuals, restored

# Left, above and corner as whole numbers: Python's // rounds down.
EQUATIONS = {
    1: lambda a, b, c: 0,
    2: lambda a, b, c: a,
    3: lambda a, b, c: b,
    4: lambda a, b, c: c,
    5: lambda a, b, c: a + b - c,
    6: lambda a, b, c: a + (b - c) // 2,
    7: lambda a, b, c: b + (a - c) // 2,
    8: lambda a, b, c: (a + b) // 2,
    9: lambda a, b, c: (a + b + c) // 3,
}
NEEDS = {1: "", 2: "column", 3: "row"}

images = st.tuples(st.integers(0, 9), st.integers(0, 9)).flatmap(
    lambda shape: arrays(np.uint8, shape, elements=st.integers(0, 255))
)


def printed(image: np.ndarray, method: int) -> np.ndarray:
    """The thesis' list, one pixel after the other."""
    pixels = image.astype(int).tolist()
    found = np.zeros(image.shape, np.uint8)
    need = NEEDS.get(method, "row column")
    for u, row in enumerate(pixels):
        for v, value in enumerate(row):
            if ("row" in need and u == 0) or ("column" in need and v == 0):
                found[u, v] = value
                continue
            a = row[v - 1] if v else 0
            b = pixels[u - 1][v] if u else 0
            c = pixels[u - 1][v - 1] if u and v else 0
            found[u, v] = (value - EQUATIONS[method](a, b, c)) % 256
    return found


@pytest.mark.parametrize("method", PREDICTORS)
@given(image=images)
@settings(max_examples=20, deadline=None)
def test_residuals_are_those_of_the_equations_and_lead_back(method, image):
    left = residuals(image, method)
    np.testing.assert_array_equal(left, printed(image, method))
    np.testing.assert_array_equal(restored(left, method), image)


@pytest.mark.parametrize("method", PREDICTORS)
def test_all_bytes_of_three_neighbours_are_predicted_right(method):
    """Every fifth value of each neighbour, and both ends: where bytes could overflow."""
    values = np.unique(np.append(np.arange(0, 256, 5), 255))
    a, b, c = (grid.ravel() for grid in np.meshgrid(values, values, values))
    image = np.stack([c, b, a, np.full(a.size, 7)], axis=1).astype(np.uint8).reshape(-1, 2, 2)
    tall = image.reshape(-1, 2)
    expected = (7 - EQUATIONS[method](a, b, c)) % 256
    np.testing.assert_array_equal(residuals(tall, method)[1::2, 1], expected)


def test_views_of_other_arrays_are_taken_as_they_look():
    image = np.arange(120, dtype=np.uint8).reshape(10, 12)[::2, ::-3]
    for method in PREDICTORS:
        np.testing.assert_array_equal(restored(residuals(image, method), method), image)


def test_a_plane_leaves_nothing_inside_with_method_5():
    u, v = np.mgrid[:20, :30]
    left = residuals((3 * u + 2 * v).astype(np.uint8), 5)
    assert not left[1:, 1:].any()


@pytest.mark.parametrize(
    ("image", "method", "message"),
    [
        (np.zeros((3, 3)), 5, "float64"),
        (np.zeros((3, 3, 3), np.uint8), 5, "3, 3, 3"),
        (np.zeros((3, 3), np.uint8), 11, "predictor 11: expected one of 1, 2, 3"),
    ],
)
def test_what_is_no_picture_or_method_is_named(image, method, message):
    with pytest.raises(ValueError, match=message):
        residuals(image, method)
