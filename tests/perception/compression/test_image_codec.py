"""The ten methods as a whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from perception.compression.byte_codes import CodingError
from perception.compression.image_codec import (
    CODERS,
    METHODS,
    coded_bits,
    compress,
    compression_ratio,
    decompress,
    image_information,
)

images = st.tuples(st.integers(0, 12), st.integers(0, 12)).flatmap(
    lambda shape: arrays(np.uint8, shape, elements=st.integers(0, 255))
)


@given(images, st.sampled_from([(m, c) for m in METHODS[:-1] for c in CODERS] + [(10, None)]))
@settings(max_examples=70, deadline=None)
def test_every_method_gives_every_picture_back(image, how):
    found = decompress(compress(image, *how))
    assert found.shape == image.shape
    np.testing.assert_array_equal(found, image)


def test_noise_is_not_compressed_by_any_method():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (256, 256), dtype=np.uint8)
    for method in METHODS:
        assert compression_ratio(noise, method) == pytest.approx(1.0, abs=0.005)
        np.testing.assert_array_equal(decompress(compress(noise, method)), noise)


def test_ratio_is_entropy_before_over_after():
    u, v = np.mgrid[:256, :256]
    # Rows of one value: 8 bit become the edges' few.
    image = u.astype(np.uint8)
    assert coded_bits(image, 1) == pytest.approx(8.0)
    assert coded_bits(image, 3) == pytest.approx(-(1 / 256) * np.log2(1 / 256) + 0.0056, abs=1e-3)
    assert compression_ratio(image, 3) == pytest.approx(8.0 / coded_bits(image, 3))
    assert image_information(image, 1) == pytest.approx(8.0 * 256 * 256)
    assert compression_ratio(np.zeros((4, 4), np.uint8), 5) == 1.0


def test_method_ten_is_huffmans_mean_word():
    image = np.array([[0, 0, 0, 0], [1, 1, 2, 3]], np.uint8)
    assert coded_bits(image, 10) == pytest.approx((4 * 1 + 2 * 2 + 2 * 3) / 8)


def test_what_cannot_be_is_named():
    image = np.zeros((3, 3), np.uint8)
    with pytest.raises(ValueError, match="method 0: expected one of 1, 2"):
        coded_bits(image, 0)
    with pytest.raises(ValueError, match="coder lzw with method 10: expected huffman"):
        compress(image, 10, "lzw")
    with pytest.raises(CodingError, match="head alone"):
        decompress(b"abc")
    with pytest.raises(CodingError, match="there is none such"):
        decompress(b"\x0b" + compress(image)[1:])
    with pytest.raises(CodingError, match="3 x 3 pixels: 8 were coded"):
        decompress(compress(image)[:-1])
