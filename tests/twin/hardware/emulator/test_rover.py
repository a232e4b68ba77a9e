"""The rover through emulated boards beside the simulation, and what its processes open."""

import dataclasses
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from models.compose import PayloadConfig, RobotPlacement
from tests.twin.hardware.bridges import add_bridges
from twin.camera import StereoConfig
from twin.connect import LineConfig, connect
from twin.describe import describe_rover
from twin.hardware.connect_boards import emulated_wiring, wired_robot
from twin.hardware.emulator.__main__ import Emulator
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.rover import ANALOGUE_SENSORS
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.roboclaw.codec import Status
from twin.hardware.serial_link import LinkError
from twin.loop import LoopRecorder, run
from twin.realism import Realism
from twin.robot import ArmMode, Command, Observation, Validity, WheelMode

ROBOT = "rover1"
PERIOD = 0.01
# One count of each channel, by hand from calibration/rover1.toml; rates are differences over a
# tick of two rounded counters.
WHEEL, ARM, VOLTS = 2.0 * np.pi / 200_000, 2.0 * np.pi / 16_384, 5.0 / 1024
CENTRE = VOLTS / 1.909859317102744
TILT = VOLTS / np.array([1.9900543098278882, 1.9269143608044716])  # pitch, roll
WRENCH = 1e-6


class Keep(LoopRecorder):
    """Keeps all ticks."""

    def __init__(self):
        self.observations, self.applied = [], []

    def record(self, tick):
        self.observations.append(tick.observations[ROBOT])
        self.applied.append(tick.applied[ROBOT])


def identified(target, config, **options):
    """What the rover saw and did while the real controller identified it."""
    keep = Keep()
    controller = RoverIdentifier(config, np.random.default_rng(7))
    with connect(target, seed=3, **options) as link:
        run(link.robots, [controller], link.clock, [keep], config.total)
        damage = link.emulator.state()[ROBOT]["damage"] if link.emulator else {}
        statistics = link.robots[ROBOT].statistics
    return keep, damage, statistics


def first_difference(one, other):
    """The first cycle and channel in which two runs differ in a single bit; None if they do not."""
    assert len(one.observations) == len(other.observations)
    for cycle, (seen, also) in enumerate(zip(one.observations, other.observations)):
        assert seen.time == also.time
        for name in Observation._fields[1:]:
            a, b = getattr(seen, name), getattr(also, name)
            same = a.value.tobytes() == b.value.tobytes() and a.validity is b.validity
            if not same or np.float64(a.stamp).tobytes() != np.float64(b.stamp).tobytes():
                return cycle, name
        for name in ("wheels", "arm"):
            a, b = (getattr(kept.applied[cycle], name) for kept in (one, other))
            if a.tobytes() != b.tobytes():
                return cycle, name
    return None


SHORT = {"approach": 0.5, "rest": 0.2, "duration": 0.8}


def configured(**changes):
    return RoverIdentifierConfig(
        ROBOT, SwingingArm.of(describe_rover(ROBOT)), "information", **changes
    )


@pytest.mark.chosen_seed  # The same as in the process of the boards, where nothing shifts it.
@pytest.mark.parametrize("faults", [0.0, 0.03])
def test_observations_and_commands_are_equal_on_quantised_and_emulated_boards(faults):
    config = configured(**SHORT)
    plain, _, _ = identified("quantised", config)
    wired, damage, _ = identified("emulated", config, lines=LineConfig(faults))
    assert len(plain.observations) == 150
    assert first_difference(plain, wired) is None
    assert (sum(damage.values()) > 10) == (faults > 0.0)


@pytest.fixture(scope="module")
def identification():
    config = configured()
    plain, _, _ = identified("quantised", config)
    assert np.ptp([seen.arm_angles.value[1] for seen in plain.observations]) > 0.5
    return config, plain


@pytest.mark.chosen_seed  # The same as in the process of the boards, where nothing shifts it.
@pytest.mark.slow
@pytest.mark.parametrize("faults", [0.0, 0.03])
def test_whole_identification_is_the_same_bit_for_bit(identification, faults):
    config, plain = identification
    wired, damage, statistics = identified("emulated", config, lines=LineConfig(faults))
    assert len(plain.observations) == 1350
    assert first_difference(plain, wired) is None
    # Whatever was damaged was asked again while the rover's time stood still.
    assert statistics.lost_boards == statistics.lost_analogue == statistics.lost_wrenches == 0
    if faults:
        assert len(damage) == 9 and sum(damage.values()) > 200


def test_difference_in_one_bit_is_seen():
    config = configured(**SHORT)
    plain, _, _ = identified("quantised", config)
    other, _, _ = identified("quantised", config)
    assert first_difference(plain, other) is None
    value = other.observations[70].arm_angles.value.copy()
    value[2] = np.nextafter(value[2], 9.0)
    changed = other.observations[70].arm_angles._replace(value=value)
    other.observations[70] = other.observations[70]._replace(arm_angles=changed)
    assert first_difference(plain, other) == (70, "arm_angles")


def driven(cycles):
    """Drive the quantised rover about; return observations, true angles and motor duties."""
    observations, duties = [], []
    with connect("quantised", seed=5) as link:
        robot, scene = link.robots[ROBOT], link.simulation
        robot.activate()
        start = robot.observe().arm_angles.value
        for cycle in range(cycles):
            phase = cycle * PERIOD * 2.0 * np.pi
            wheels = np.array([6.0, -4.0, 5.0, 7.0]) * np.sin(0.5 * phase)
            goal = start + 0.25 * np.sin(phase * np.array([0.4, 0.6, 0.8, 1.0]))
            observations.append(robot.observe())
            robot.command(Command(wheels, goal, WheelMode.SPEED, ArmMode.POSITION))
            link.clock.tick()
            # Behind the amplifier: what the motors were given in this tick.
            duties.append(scene.robots[ROBOT].save().duty)
        state = scene.data.qpos.copy()
    return observations, duties, state


def test_boards_err_by_a_count_from_the_simulation_that_gets_the_same_voltages():
    """Noise has the same seed in both, and is there before the converter: it falls out.

    A counter's rate is the mean over a tick, so it is held against the true angles' difference, not
    against the speed at the end. What is read every fourth tick is compared when it was read.
    """
    seen, duties, state = driven(400)
    worst = dict.fromkeys(
        ("wheel_speeds", "arm_rates", "arm_angles", "centre", "tilt", "wrench"), 0.0
    )
    with connect("sim", realism=Realism(ANALOGUE_SENSORS), seed=5) as link:
        robot, data = link.robots[ROBOT], link.simulation.data
        add_bridges(link, ROBOT)
        names = ("front_left", "front_right", "rear_left", "rear_right")
        wheels = [data.joint(f"{ROBOT}/{name}_joint") for name in names]
        before = None
        robot.activate()
        for boards, duty in zip(seen, duties):
            plain = robot.observe()
            assert boards.time == plain.time

            def err(name, measured, true, count):
                difference = np.max(np.abs(measured - true) / count)
                worst[name] = max(worst[name], float(difference))

            turned = np.array([joint.qpos[0] for joint in wheels])
            angles = plain.arm_angles.value
            if before is not None:
                rates = (turned - before[0]) / PERIOD, (angles - before[1]) / PERIOD
                err("wheel_speeds", boards.wheel_speeds.value, rates[0], WHEEL / PERIOD)
                err("arm_rates", boards.arm_rates.value, rates[1], ARM / PERIOD)
            before = turned, angles
            err("arm_angles", boards.arm_angles.value, angles, ARM)
            err("wrench", boards.arm_base_wrench.value, plain.arm_base_wrench.value, WRENCH)
            if boards.centre_angle.stamp == plain.time:
                err("centre", boards.centre_angle.value, plain.centre_angle.value, CENTRE)
            if boards.inclinometer.stamp == plain.time:
                err("tilt", boards.inclinometer.value, plain.inclinometer.value, TILT)
            robot.command(Command(*duty))
            link.clock.tick()
        np.testing.assert_array_equal(data.qpos, state)
    print({name: round(value, 3) for name, value in worst.items()})
    for name, value in worst.items():
        assert 0.1 < value <= (1.0 if "rate" in name or "speed" in name else 0.5) + 1e-6, name


def test_emulated_rover_is_homed_and_has_every_sensor_of_its_boards():
    with connect("emulated") as link:
        robot, truth = link.robots[ROBOT], link.emulator.state()[ROBOT]
        seen = robot.observe()
        np.testing.assert_allclose(seen.arm_angles.value, truth["arm_angles"], atol=0.51 * ARM)
        assert seen.arm_base_wrench.value[2] == pytest.approx(0.76 * 9.81, abs=0.3)
        missing = [n for n in Observation._fields[1:] if not getattr(seen, n).usable]
        assert missing == ["accelerometer", "gyro", "heading", "stereo"]
        assert all(getattr(seen, name).validity is Validity.MISSING for name in missing)


def sockets(pid):
    """Protocol, local and remote address of each internet socket of a process."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        link = os.readlink(entry)
        if link.startswith("socket:["):
            inodes.add(link[len("socket:[") : -1])
    found = []
    for protocol in ("tcp", "tcp6", "udp", "udp6", "raw", "raw6"):
        for line in Path(f"/proc/{pid}/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                found.append((protocol, fields[1], fields[2]))
    return found


def hex_address(port):
    return f"0100007F:{port:04X}"  # 127.0.0.1, as the kernel writes it


def serial_ports(pid):
    links = {os.readlink(entry) for entry in Path(f"/proc/{pid}/fd").iterdir()}
    return {link for link in links if link.startswith(("/dev/pts/", "/dev/tty"))}


@pytest.fixture(scope="module")
def emulator():
    process = EmulatorProcess(SceneConfig())
    yield process
    process.close()


HOST = """
import sys
import numpy as np
from twin.connect import LineConfig, connect
from twin.robot import Command
with connect(sys.argv[1]) as link:
    robot = link.robots["rover1"]
    if "home" in sys.argv[1]:
        robot.activate()
    print("ready", flush=True)
    while True:
        if "home" in sys.argv[1]:
            robot.observe()
            robot.command(Command(np.full(4, 0.4)))
        link.clock.tick()
"""


class Host:
    """A process that connects to boards, and drives them if it is given the homing angles."""

    def __init__(self, target):
        self.process = subprocess.Popen(
            [sys.executable, "-c", HOST, target], stdout=subprocess.PIPE, stdin=subprocess.DEVNULL
        )

    def __enter__(self):
        assert self.process.stdout.readline() == b"ready\n"
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def wiring(emulator, *words):
    ports = emulator.ports[ROBOT]
    names = {
        "analogue": f"analogue={ports['analogue']}",
        "wrench": f"wrench=127.0.0.1:{ports['wrench']}",
    }
    chosen = [names.get(word, word) for word in words]
    return ",".join([f"serial:{ports['bus']}", "most_days=99999", *chosen])


def test_emulator_listens_on_loopback_alone_and_to_no_connection(emulator):
    emulator.tick()
    port = emulator.ports[ROBOT]["wrench"]
    assert sockets(emulator._process.pid) == [("udp", hex_address(port), "00000000:0000")]


def test_host_opens_what_is_named_and_nothing_else(emulator):
    ports = emulator.ports[ROBOT]
    with Host(wiring(emulator, "analogue", "wrench")) as host:
        assert serial_ports(host.process.pid) == {ports["bus"], ports["analogue"]}
        [(protocol, local, remote)] = sockets(host.process.pid)
        assert protocol == "udp" and local.startswith("0100007F:")
        assert remote == hex_address(ports["wrench"])
    with Host(wiring(emulator)) as host:
        assert serial_ports(host.process.pid) == {ports["bus"]}
        assert sockets(host.process.pid) == []


def test_boards_stop_by_themselves_when_their_host_is_killed(emulator):
    pose = ":".join(map(str, emulator.state()[ROBOT]["arm_angles"]))
    with Host(wiring(emulator, f"home={pose}")) as host:
        for _ in range(1000):
            emulator.tick()
            time.sleep(PERIOD)
            if np.count_nonzero(emulator.state()[ROBOT]["codes"]) == 4:
                break
        host.process.send_signal(signal.SIGKILL)
        host.process.wait()
        codes = []
        for _ in range(40):
            emulator.tick()
            codes.append(np.count_nonzero(emulator.state()[ROBOT]["codes"]))
    # The boards' timeout of 0.2 s, and the tick in which it ends.
    assert codes[0] == 4 and codes[10] == 4
    assert codes[21:] == [0] * 19


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "name the motor boards' port first"),
        (",analogue=/dev/nowhere", "name the motor boards' port first"),
        ("/dev/nowhere,bluetooth=1", "'bluetooth=1' is not understood.*analogue, wrench, stereo"),
        ("/dev/nowhere,analogue", "'analogue' is not understood"),
        ("/dev/nowhere,wrench=10.0.0.1:ft", "wrench=10.0.0.1:ft has no port number"),
        ("/dev/nowhere,wrench=10.0.0.1:70000", "wrench=10.0.0.1:70000 has no port number"),
        ("/dev/nowhere,home=0:1:2", "home=0:1:2 is not four joint angles"),
        ("/dev/nowhere,home=0:1:2:nan", "home=0:1:2:nan is not four joint angles"),
        ("/dev/nowhere,most_days=-1", "most_days=-1 is no whole number of days"),
    ],
)
def test_ill_words_of_a_target_give_one_clear_sentence(words, message):
    with pytest.raises(ValueError, match=message) as caught:
        connect(f"serial:{words}")
    assert "\n" not in str(caught.value)


def test_unknown_fault_is_refused_and_the_emulator_continues(emulator):
    for wrong in ({"kind": "earthquake"}, {"kind": "e_stop", "address": 0x99}):
        with pytest.raises(LinkError, match="no such fault"):
            emulator.inject(ROBOT, **wrong)
    with pytest.raises(LinkError, match="no such fault: 'rover9'"):
        emulator.inject("rover9", "e_stop")
    before = emulator.time
    emulator.tick()
    assert emulator.time == pytest.approx(before + PERIOD)


def test_emulator_that_does_not_start_leaves_nothing_open(monkeypatch):
    started, folders = [], set(Path(tempfile.gettempdir()).glob("fieldtwin-*"))
    popen = subprocess.Popen

    def keep(command, **options):
        started.append(popen(["false"], **options))
        return started[0]

    monkeypatch.setattr(subprocess, "Popen", keep)
    with pytest.raises(LinkError, match="the emulator ended"):
        EmulatorProcess(SceneConfig(stereo=StereoConfig()))
    assert started[0].returncode == 1
    assert started[0].stdin.closed and started[0].stdout.closed
    assert set(Path(tempfile.gettempdir()).glob("fieldtwin-*")) <= folders


def test_emulator_that_died_is_a_link_error():
    emulator = EmulatorProcess(SceneConfig())
    emulator._process.kill()
    emulator._process.wait()
    with pytest.raises(LinkError, match="the emulator"):
        emulator.tick()
    emulator.close()


def test_faults_of_a_file_begin_and_end_in_their_time():
    faults = [
        {"time": 0.03, "kind": "e_stop", "address": 0x81},
        {"time": 0.02, "kind": "brown_out", "duration": 0.02},
        {"robot": "rover2", "time": 0.0, "kind": "driver_fault"},
    ]
    pair = RobotPlacement(ROBOT), RobotPlacement("rover2", (2.0, 0.0))
    emulator = Emulator(SceneConfig(pair), 0.0, faults)
    rover, boards = emulator.scene.rovers[ROBOT], emulator.rigs[ROBOT].boards.boards
    volts, stopped = [], []
    for _ in range(6):
        emulator.tick()
        volts.append(rover.battery)
        stopped.append([address for address, board in boards.items() if board.status.errors])
    emulator.close()
    assert volts == [12.0, 12.0, 9.0, 9.0, 12.0, 12.0]
    assert stopped == [[]] * 3 + [[0x81]] * 3
    assert boards[0x81].status is Status.E_STOP


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"robot": "rover9"}, "fault of robot 'rover9': there are rover1"),
        ({"kind": "rust"}, "kind 'rust'; expected one of bus_silent, .*, camera_unplugged"),
        ({"address": 0x99}, "no motor board 0x99; there are 0x80, 0x81, 0x82, 0x83"),
    ],
)
def test_fault_of_nothing_that_is_there_is_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        Emulator(SceneConfig(), 0.0, [{"time": 1.0, "kind": "e_stop", **wrong}])


def test_quantised_rover_has_the_images_of_the_simulated_one():
    pairs = []
    for target in ("sim", "quantised"):
        with connect(target, stereo=StereoConfig(noise_db=None), seed=3) as link:
            link.clock.tick()
            pair = link.robots[ROBOT].observe().stereo
            assert pair.usable and pair.value.dtype == np.uint8
            pairs.append(pair.value)
    np.testing.assert_array_equal(*pairs)


@pytest.mark.chosen_seed  # The same as in the process of the boards, where nothing shifts it.
def test_payload_is_carried_on_emulated_boards_as_on_quantised_ones():
    box = PayloadConfig(0.3, (0.01, 0.02, 0.03))
    wrenches = {}
    for target, payload in (("quantised", box), ("emulated", box), ("quantised", None)):
        with connect(target, robots=[RobotPlacement(ROBOT, payload=payload)], seed=3) as link:
            link.clock.tick()
            wrenches[target, payload] = link.robots[ROBOT].observe().arm_base_wrench.value
    np.testing.assert_array_equal(wrenches["quantised", box], wrenches["emulated", box])
    assert np.abs(wrenches["quantised", box] - wrenches["quantised", None]).max() > 0.5


def test_wired_robot_reads_the_named_captures(emulator, tmp_path):
    names = []
    for side, level in (("left", 40), ("right", 160)):
        for k in range(3):
            cv2.imwrite(str(tmp_path / f"{side}_{k:04d}.png"), np.full((8, 12), level, np.uint8))
        names.append(str(tmp_path / f"{side}_%04d.png"))
    wiring = emulated_wiring(emulator, ROBOT)
    wiring = dataclasses.replace(wiring, patient=True, stereo=":".join(names))
    robot = wired_robot(wiring, lambda: emulator.time)
    try:
        pair = robot.observe().stereo
    finally:
        robot.close()
    assert pair.value.shape == (2, 8, 12) and pair.usable
    assert pair.value[0].max() == 40 and pair.value[1].min() == 160
