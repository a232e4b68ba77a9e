"""A log read back as the ticks of which it was written."""

import numpy as np
import pytest

from tests.twin.logs.test_writing import logged
from twin.logs.log import Log, LogError
from twin.logs.ticks import robots_of, ticks_of
from twin.logs.writing import SENSORS


def test_ticks_are_what_the_controller_saw_and_what_was_applied(tmp_path):
    log, ticks = logged(tmp_path / "run.mcap")
    assert robots_of(log) == ["rover1"]
    found = list(ticks_of(log, "rover1"))
    assert len(found) == len(ticks)
    for (seen, applied), tick in zip(found, ticks, strict=True):
        true = tick.observations["rover1"]
        assert seen.time == pytest.approx(true.time, abs=1e-9)
        for name in SENSORS:
            channel, expected = getattr(seen, name), getattr(true, name)
            assert channel.usable == expected.usable
            if expected.usable:
                assert channel.stamp == pytest.approx(expected.stamp, abs=1e-9)
                np.testing.assert_array_equal(channel.value, expected.value, name)
        np.testing.assert_array_equal(applied.wheels, tick.applied["rover1"].wheels)
        np.testing.assert_array_equal(applied.arm, tick.applied["rover1"].arm)


def test_a_rover_that_is_not_in_the_log_is_refused(tmp_path):
    log, _ = logged(tmp_path / "run.mcap")
    with pytest.raises(LogError, match="no rover 'master' in the log; there are rover1"):
        list(ticks_of(log, "master"))
    assert robots_of(Log({})) == []
