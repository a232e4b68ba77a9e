"""Programs that are killed while a person drives, and how that is scored."""

import json

import pytest

from experiments.harness.output import Output
from experiments.living import kills
from experiments.living.kills import Killed, kill_often
from experiments.living.living_twin import measure_kills
from experiments.living.living_twin_options import Options


@pytest.mark.parametrize(
    ("found", "short"),
    [
        ([Killed(0.2, 9.0, False), Killed(-0.1, 4.0, False)], set()),
        ([Killed(0.2, 9.0, False), Killed(1.1, 11.0, True)], {"lost", "until", "rovers"}),
    ],
)
def test_the_worst_kill_counts(tmp_path, found, short):
    output = Output("living-twin", Options(out=tmp_path), [])
    measure_kills(found, output)
    output.finish()
    output.close()
    metrics = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())
    assert metrics["measured"]["kill_moved"] == sum(each.moved for each in found)
    failed = {check["name"].split()[0].strip(",") for check in metrics["checks"] if not check["ok"]}
    assert failed == short


@pytest.mark.slow
@pytest.mark.real_time
def test_a_rover_is_back_and_still_after_a_kill(monkeypatch):
    monkeypatch.setattr(kills, "LATEST", 1.5)
    (found,) = kill_often(3, 1)
    assert found.lost < 1.0 and not found.moved
    assert 0.5 < found.back < 60.0  # noqa: PLR2004
