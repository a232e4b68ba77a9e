"""The mission on two rovers that are opened by their boards' ports."""

from pathlib import Path

import pytest

from experiments.harness.contract import OptionError
from experiments.mission.mission import Options, check_radios
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.trial import MissionTrial, prepared
from tests.twin.hardware.realtime_emulator import serial_target
from twin.hardware.serial_link import LinkError
from twin.loop import run
from twin.robot import RobotError

SLOW_DOWN = 3
"""Both rovers, their boards and this process have two cores for themselves, and the watchdog allows
0.15 s of the robots' time."""
TRIES = 4
"""A machine that stalls stops the robots, as it must; a fault of the code stops each try."""


def test_the_mission_accepts_two_robots_by_their_ports() -> None:
    target = "serial:/dev/a,radio=/dev/c,robot=rover1,serial:/dev/b,radio=/dev/d,robot=rover2"
    assert Options(quick=True, robot=target).robot == target
    check_radios(target)
    with pytest.raises(OptionError, match="need a radio"):
        check_radios("serial:/dev/a,radio=/dev/c,robot=rover1,serial:/dev/b,robot=rover2")


@pytest.mark.slow
@pytest.mark.real_time
def test_the_mission_on_ports_ends_its_first_stage(tmp_path: Path) -> None:
    stops = []
    while len(stops) < TRIES:
        try:
            _end_first_stage(tmp_path / str(len(stops)))
        except (RobotError, LinkError) as error:
            stops.append(str(error))
        else:
            return
    pytest.fail("\n".join(stops))


def _end_first_stage(folder: Path) -> None:
    folder.mkdir()
    with (
        serial_target((MASTER, SLAVE), SLOW_DOWN, folder) as target,
        prepared(MissionTrial(seed=7, robot=target)) as mission,
    ):
        team, connection = mission.team, mission.connection
        run(
            connection.robots,
            [team],
            connection.clock,
            duration=45.0,
            until=lambda: any(team.ended),
        )
        assert team.ended == ["identify"]
        for part in team.parts:
            assert part.belief.identification is not None
            assert (part.belief.pitch is None) == bool(part.belief.doubts)
