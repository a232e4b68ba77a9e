import numpy as np
import pytest

from models.compose import RobotPlacement
from twin.connect import connect
from twin.hardware.serial_link import LinkError
from twin.hardware.wiring import Wiring
from twin.loop import run
from twin.robot import Command, Lifecycle, WheelMode


class Drive:
    def reset(self):
        pass

    def step(self, observations):
        command = Command(np.full(4, 4.0), wheel_mode=WheelMode.SPEED)
        return dict.fromkeys(observations, command)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("serial", "unknown robot 'serial'; available: sim, quantised, emulated, serial:PORT"),
        ("serial:", "name the motor boards' port first"),
        ("serial:/dev/nowhere,wrnch=1", "'wrnch=1' is not understood; .*analogue, wrench"),
        ("serial:/dev/nowhere,robot=rover9", "rover9.toml: cannot be read"),
        ("serial:/dev/nowhere,most_days=x", "most_days=x is no whole number"),
        ("serial:/dev/nowhere", "2002-01-01, .* needs at most 365"),
        ("serial:/dev/nowhere,most_days=99999", "/dev/nowhere: cannot be opened"),
    ],
)
def test_wrong_words_are_named(target, message):
    with pytest.raises((ValueError, LinkError), match=message):
        connect(target)


def test_unknown_robot_is_named_with_what_there_is():
    with pytest.raises(ValueError, match="unknown robot 'simm'; available: sim"):
        connect("simm")


def test_two_simulated_rovers_drive_forward_by_themselves():
    places = (RobotPlacement("a", (-0.6, 0.0)), RobotPlacement("b", (0.6, 0.0)))
    with connect("sim", robots=places) as link:
        assert list(link.robots) == ["a", "b"]
        assert {r.lifecycle for r in link.robots.values()} == {Lifecycle.INACTIVE}
        run(link.robots, [Drive()], link.clock, duration=2.0)
        for name in "ab":
            joint = link.simulation.data.joint(f"{name}/root_joint")
            # 4 rad/s on wheels of 48.7 mm for 2 s, less the start.
            assert joint.qpos[1] == pytest.approx(0.39, abs=0.04)
            speeds = link.robots[name].observe().wheel_speeds.value
            assert np.all(speeds > 3.5)
    assert {r.lifecycle for r in link.robots.values()} == {Lifecycle.UNCONFIGURED}


def test_settled_rover_is_at_rest_at_time_zero():
    with connect("sim") as link:
        assert link.clock.time == 0.0
        assert np.abs(link.simulation.data.qvel).max() < 1e-2


def test_two_robots_are_named_behind_serial_each_with_its_ports():
    first, second = Wiring.parse_all(
        "/dev/a,radio=/dev/r,slow_down=4,robot=one,serial:/dev/b,robot=two,radio=/dev/s,slow_down=4"
    )
    assert (first.bus, first.robot, first.radio) == ("/dev/a", "one", "/dev/r")
    assert (second.bus, second.robot, second.radio) == ("/dev/b", "two", "/dev/s")
    # Boards whose time is slow may take as long to answer.
    assert first.slow_down == second.slow_down == 4.0 and first.patient
    for words, match in (
        ("/dev/a,serial:/dev/b", "two robots have robot=rover1"),
        ("/dev/a,serial:/dev/a,robot=two", "two robots have bus=/dev/a"),
        ("/dev/a,slow_down=2,serial:/dev/b,robot=two", "the same for all"),
        ("/dev/a,slow_down=0.5", "no factor of 1 or more"),
    ):
        with pytest.raises(ValueError, match=match):
            Wiring.parse_all(words)
