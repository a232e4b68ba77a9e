"""Scheduled faults of an emulated rig begin and end in their time, alone and one over another."""

import numpy as np
import pytest

from twin.hardware.calibration.calibration import calibration_path, read_calibration
from twin.hardware.emulator.faults import LineFaultConfig, RobotFault, ScheduledFault
from twin.hardware.emulator.rig import EmulatedRig
from twin.robot import MISSING


class Bench:
    """A rover at rest on a supply of 13.2 V."""

    name = "bench"
    calibration = read_calibration(calibration_path("rover1"))

    def __init__(self):
        self.battery = 13.2
        self.codes = np.zeros(8, dtype=np.int64)
        self.currents = np.zeros(8)

    def counts(self):
        return np.zeros(8, dtype=np.int64)

    def wrench(self):
        return np.zeros(6, dtype=int)

    def analogue(self, pin):
        return 0

    def stereo(self):
        return MISSING


def watched(faults, look, ticks=9):
    """What is seen of rover and rig after each tick of 10 ms."""
    rover = Bench()
    rig = EmulatedRig(rover, LineFaultConfig(), faults, np.random.default_rng(0))
    seen = []
    for tick in range(ticks):
        rig.before_tick(0.01 * tick, 0.01)
        seen.append(look(rover, rig))
    rig.close()
    return seen


def over_one_another(kind):
    """Two faults from the second tick to the fifth, and one that outlasts the next."""
    spans = [(0.01, 0.03), (0.02, 0.01), (0.05, 0.01), (0.055, 0.02)]
    return [ScheduledFault(begin, kind, duration) for begin, duration in spans]


def test_after_a_brown_out_the_battery_is_what_it_was():
    faults = [ScheduledFault(0.01, RobotFault.BROWN_OUT, 0.02)]
    assert watched(faults, lambda rover, _: rover.battery, 4) == [13.2, 9.0, 9.0, 13.2]


@pytest.mark.parametrize(
    ("kind", "look"),
    [
        (RobotFault.BROWN_OUT, lambda rover, _: rover.battery < 10.0),
        (RobotFault.BUS_SILENT, lambda _, rig: rig.bus_line.silent),
    ],
)
def test_a_fault_lasts_until_the_last_of_its_kind_ends(kind, look):
    expected = [False, True, True, True, False, True, True, True, False]
    assert watched(over_one_another(kind), look) == expected
