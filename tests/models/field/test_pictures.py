"""The ground's texture, and the pictures of the model folders."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from models.compose import FLAT, FOLDER, TEXTURE_TILE, make_model
from models.render_pictures import LARGEST, Shot, take, write

EDGE = 400
"""Edge of a picture that shows one metre of ground [px]."""


@pytest.mark.parametrize("relief", [0.0, 5e-4])
def test_ground_texture_repeats_every_quarter_metre_and_not_sooner(relief):
    model = make_model(dataclasses.replace(FLAT, relief=relief, texture_pixels=512), [])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    model.vis.global_.fovy = 45.0
    distance = 0.5 / math.tan(math.radians(22.5))
    view = Shot((0.03, 0.02, 0.0), distance, 90.0, -90.0)
    grey = take(model, data, view, (EDGE, EDGE)).mean(axis=2)
    spectrum = np.abs(np.fft.fft2(grey - grey.mean())) ** 2
    correlation = np.fft.ifft2(spectrum).real
    correlation /= correlation[0, 0]
    period = round(TEXTURE_TILE * EDGE)
    for line in (correlation[0], correlation[:, 0]):
        assert line[period] > 0.8
        assert line[period // 4 : period - period // 8].max() < 0.6


def test_a_picture_that_stays_too_large_is_refused(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (1024, 1024, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match="more than 200000"):
        write(noise, tmp_path / "noise.png")


@pytest.mark.parametrize(
    "part", ["rover", "arm", "stereo_head", "field", "compliant_base", "card_and_slot", "braid"]
)
def test_every_model_folder_has_a_readme_and_a_small_picture(part):
    assert (FOLDER / part / "README.md").stat().st_size > 500
    assert 10_000 < (FOLDER / part / f"{part}.png").stat().st_size < LARGEST
