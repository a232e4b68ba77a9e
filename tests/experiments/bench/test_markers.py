"""The benchmark of markers: its truth and its peer, and a short run."""

import json

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.bench.markers import centre_errors
from experiments.ch5.marker_scene import MarkerScene, expectation
from perception.markers.bodies import DETECTORS


def test_unfound_centres_are_not_counted_as_errors():
    truth = np.array([[10.0, 10.0], [50.0, 50.0]])
    errors = centre_errors(np.array([[10.3, 10.4]]), truth)
    assert errors[0] == pytest.approx(0.5) and np.isnan(errors[1])
    assert np.isnan(centre_errors(np.empty((0, 2)), truth)).all()


@pytest.mark.slow
def test_rendered_markers_are_at_their_true_places():
    scene = MarkerScene(np.random.default_rng(0), noise_db=None)
    view = scene.view(0.5, 40.0)
    for image, truth in zip(view.pair, view.ellipses):
        found = DETECTORS["blob"](image, scene.geometry, expectation(0.5))
        assert np.nanmedian(centre_errors(found.centres, truth)) < 0.1


@pytest.mark.slow
def test_markers_beside_opencv(tmp_path):
    assert main(["bench", "--only", "markers", "--quick", "--out", str(tmp_path)]) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    for name in DETECTORS:
        assert measured[f"marker_error_px/{name}"]["median"] < 0.1
        assert measured[f"marker_found_fraction/{name}"] > 0.9
        assert measured[f"pose_found_fraction/{name}/tilt_known"] > 0.85
        assert measured[f"pose_error_mm/head_on_0.5m/{name}/alone"]["median"] < 0.4
    assert measured["marker_error_ratio/cv2_over_tht"] > 5.0
