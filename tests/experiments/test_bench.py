import json

import numpy as np
import pytest

from controllers.identification.arm_motion import MODES, RigidArm
from controllers.identification.compliant_base import ArmOnMount
from controllers.identification.output_error import OutputError, Window
from experiments.__main__ import main
from experiments.bench_identification import fit_ours, record

ARMS = {mode: ArmOnMount.of(RigidArm(), mode) for mode in MODES}


def test_window_after_window_gives_what_all_at_once_gives():
    recording = record(1.2, seed=4)
    whole = OutputError(ARMS)
    motions, outputs = recording.motions(), recording.joined()
    whole.add({mode: Window(motions[mode], outputs[mode], recording.sigma) for mode in ARMS})
    fit = whole.fit()
    deviation = np.sqrt(np.diag(fit.covariance))
    difference = (fit_ours(recording, ARMS) - fit.parameters) / deviation
    assert np.max(np.abs(difference)) < 0.05


def test_unknown_benchmark_is_named(capsys):
    assert main(["bench", "--only", "speed"]) == 2
    assert "speed: unknown; there are loop, identification, mapping" in capsys.readouterr().err


@pytest.mark.slow
def test_identification_beside_its_peer(tmp_path):
    words = ["bench", "--only", "identification", "--quick", "--out", str(tmp_path)]
    assert main(words) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    ours, peer = (measured[f"sysid/{who}_error_percent"]["median"] for who in ("ours", "sysid"))
    # Both seek the same optimum; what differs is chance and the weak prior.
    assert ours < 5.0 and 0.3 < ours / peer < 3.0
    assert measured["sysid_time_ratio"]["median"] < 0.2
