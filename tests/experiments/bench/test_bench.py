import dataclasses
import json
import pkgutil
import sys

import numpy as np
import pytest

from controllers.identification.arm_motion import MODES, RigidArm
from controllers.identification.compliant_base import ArmOnMount, BaseState, simulate
from controllers.identification.output_error import FINAL_SUBSTEPS, OutputError, Window
from controllers.identification.parameters import Prior, from_mapping
from experiments.__main__ import main
from experiments.bench.bench_options import BENCHMARKS
from experiments.bench.identification import (
    FINE_SUBSTEPS,
    PEER_SUBSTEPS,
    SysidPeer,
    fit_ours,
    peer_optimum,
    record,
)
from models.datasheets import TABLE_2_1_TRUTH

ARMS = {mode: ArmOnMount.of(RigidArm(), mode) for mode in MODES}
TRUTH = from_mapping(TABLE_2_1_TRUTH)


def test_window_after_window_gives_what_all_at_once_gives():
    recording = record(1.2, seed=4)
    whole = OutputError(ARMS)
    motions, outputs = recording.motions(), recording.joined()
    whole.add({mode: Window(motions[mode], outputs[mode], recording.sigma) for mode in ARMS})
    fit = whole.fit()
    deviation = np.sqrt(np.diag(fit.covariance))
    difference = (fit_ours(recording, ARMS) - fit.parameters) / deviation
    assert np.max(np.abs(difference)) < 0.05


def without_noise(recording):
    still = [{mode: np.zeros_like(y) for mode, y in part.items()} for part in recording.clean]
    return dataclasses.replace(recording, noise=still)


def largest_misfit(recording, substeps):
    """Return what the peer's model leaves of the data at the truth, in deviations of the noise."""
    motions, outputs = recording.motions(), recording.joined()
    peer = SysidPeer(motions, outputs, recording.sigma, ARMS, Prior(), substeps)
    return np.abs(peer.residual(TRUTH)).max()


def test_the_data_are_finer_than_either_side_integrates():
    data = without_noise(record(0.4, seed=4))
    own = data.integrated(PEER_SUBSTEPS)
    coarse = largest_misfit(data, PEER_SUBSTEPS)
    # RK4's error falls with the fourth power of the step, and on its own steps there is none.
    assert largest_misfit(data, FINE_SUBSTEPS) < coarse / 12
    assert largest_misfit(own, PEER_SUBSTEPS) < coarse / 50
    motions, outputs = data.motions(), data.joined()
    for mode, arm in ARMS.items():
        start = BaseState.at_rest()
        ours, *_ = simulate(TRUTH, arm, motions[mode], start, False, FINAL_SUBSTEPS)
        assert np.abs((ours - outputs[mode]) / data.sigma).max() < coarse


def test_the_peer_s_least_cost_is_at_the_truth_where_its_steps_made_the_data():
    data = without_noise(record(0.8, seed=4)).integrated(PEER_SUBSTEPS)
    found = peer_optimum(data, ARMS, PEER_SUBSTEPS, near=1.02 * TRUTH)
    np.testing.assert_allclose(found, TRUTH, rtol=1e-4, atol=1e-5)


def test_unknown_benchmark_is_named(capsys):
    assert main(["bench", "--only", "speed"]) == 2
    assert "speed: unknown; there are loop, identification, mapping" in capsys.readouterr().err


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_exists(name):
    assert callable(pkgutil.resolve_name(BENCHMARKS[name]))


@pytest.mark.slow
def test_identification_beside_its_peer(tmp_path):
    words = ["bench", "--only", "identification", "--quick", "--seeds", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    ours, peer = (measured[f"sysid/{who}_error_percent"]["median"] for who in ("ours", "sysid"))
    # Both seek the same optimum; what differs is chance and the weak prior.
    assert ours < 10.0 and peer < 10.0
    assert measured["sysid_time_ratio"]["median"] > 0.0


def test_a_peer_that_is_not_installed_is_named_with_its_extra(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "pyoctomap", None)
    monkeypatch.delitem(sys.modules, "experiments.bench.mapping", raising=False)
    assert main(["bench", "--only", "mapping", "--out", str(tmp_path)]) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last == (
        "error: --only mapping: the peer pyoctomap is missing (pip install 'fieldtwin[peers]')"
    )


def test_a_peer_whose_own_packages_are_missing_is_named_with_its_extra(
    monkeypatch, tmp_path, capsys
):
    """Then mujoco.sysid can be imported, and is empty."""
    monkeypatch.delattr("mujoco.sysid.ModelSequences")
    monkeypatch.delitem(sys.modules, "experiments.bench.identification", raising=False)
    assert main(["bench", "--only", "identification", "--out", str(tmp_path)]) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last == (
        "error: --only identification: the peer mujoco.sysid is missing "
        "(pip install 'fieldtwin[peers]')"
    )
