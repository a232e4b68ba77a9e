"""``doctor --robot``: the state of a robot on its boards, before anything moves."""

import contextlib
import time
from collections.abc import Callable, Iterator

import numpy as np

from experiments.doctor.findings import Finding
from experiments.harness.robot_option import wiring_of
from twin.clock import WallClock
from twin.describe import describe_rover
from twin.hardware.board_robot import BoardRobot
from twin.hardware.board_set import WiredBoards
from twin.hardware.calibration.calibration import (
    Calibration,
    CalibrationError,
    calibration_path,
    read_calibration,
)
from twin.hardware.connect_boards import emulated_wiring, open_boards
from twin.hardware.emulator.faults import RobotFault
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.roboclaw.codec import BoardCommand, Status
from twin.hardware.serial_link import LinkError
from twin.hardware.wiring import Wiring
from twin.robot import Channel, Observation, RobotError
from twin.servo import SERVO_PERIOD

WATCHING = 2.0
"""Duration of the watch on the sensors [s]."""
FRESH = 0.95
"""Share of the cycles in which a channel must be usable."""
MISSED = 0.01
"""Share of the cycles that may be missed."""
STILL = 0.02
"""Speed of a shaft above which it is not at rest [rad/s]."""
POLL = 0.05  # [s]


SENSORS = {
    "inclinometer": ("pitch {:+.2f}, roll {:+.2f} degrees", 180.0 / np.pi),
    "centre_angle": ("{:+.2f} degrees", 180.0 / np.pi),
    "arm_base_wrench": ("force {:+.2f}, {:+.2f}, {:+.2f} N", 1.0),
}
"""Text of each watched channel, and factor of the values in it."""


def examine_robot(target: str, patience: float) -> Iterator[Finding]:
    """Examine a robot's calibration, boards, limits, sensors and e-stop; nothing is driven.

    Args:
        target: ``serial:PORT[,NAME=VALUE...]`` or ``emulated``.
        patience: Longest wait for a person at the e-stop [s].

    Raises:
        OptionError: If the target is unknown or misspelt.
    """
    if target == "emulated":
        yield from _examine_emulated(patience)
    else:
        yield from _examine(wiring_of(target), _ask_person, patience)


def _ask_person() -> None:
    print("        press the e-stop, wait until this continues, then release it", flush=True)


def _examine_emulated(patience: float) -> Iterator[Finding]:
    scene = SceneConfig()
    name = scene.robots[0].name
    with contextlib.closing(EmulatorProcess(scene, realtime=True)) as emulator:
        wiring = emulated_wiring(emulator, name)

        def press() -> None:
            for address in wiring.load_calibration().drive.boards:
                emulator.inject(name, RobotFault.E_STOP.value, address=address)

        yield from _examine(wiring, press, patience)


def _examine(wiring: Wiring, press_stop: Callable[[], None], patience: float) -> Iterator[Finding]:
    """Examine one thing after the other, until one is missing that the next needs.

    Args:
        wiring: Ports of the boards.
        press_stop: Function that presses the e-stop, or prompts a person to.
        patience: Longest wait for the e-stop [s].
    """
    yield _calibration_finding(wiring)
    try:
        # Even an old one will do to examine the boards.
        calibration = read_calibration(wiring.calibration or calibration_path(wiring.robot))
    except CalibrationError:
        return
    try:
        boards = open_boards(wiring, calibration)
    except LinkError as error:
        yield Finding("ports", str(error), "check cable, name and permissions of the port")
        return
    with contextlib.closing(boards):
        found = [_board_finding(boards, address) for address in boards.addresses]
        yield from found
        if any("no answer" in finding.value for finding in found):
            return
        robot = BoardRobot(describe_rover(wiring.robot), boards, calibration, time.monotonic)
        try:
            robot.configure()
        except RobotError as error:
            yield Finding("limits", str(error), "switch the boards off and on, then try again")
            return
        yield Finding("limits", _limits(calibration))
        yield from _sensor_findings(robot)
        yield _stop_finding(boards, press_stop, patience)


def _calibration_finding(wiring: Wiring) -> Finding:
    try:
        wiring.load_calibration()
    except CalibrationError as error:
        return Finding("calibration", str(error), "calibrate, or name another file")
    return Finding("calibration", f"of {wiring.robot}, not too old")


def _board_finding(boards: WiredBoards, address: int) -> Finding:
    """Read a motor board's version, voltages, temperature and status."""
    what = f"motor board {address:#x}"
    try:
        version = boards.bus.version(address)
        state = boards.state(address)
        logic = 0.1 * boards.bus.read(address, BoardCommand.GET_LOGIC_VOLTAGE)[0]
        warmth = 0.1 * boards.bus.read(address, BoardCommand.GET_TEMPERATURE)[0]
    except LinkError as error:
        return Finding(what, f"no answer ({error})", "check power, address and baud rate 460800")
    status = (state.status.name or hex(state.status)).lower()
    value = f"{version}, {state.battery:.1f} V, logic {logic:.1f} V, {warmth:.0f} C, {status}"
    return Finding(what, value, "see the status" if state.status.errors else "")


def _limits(calibration: Calibration) -> str:
    currents = ", ".join(f"{axis.current_limit:g}" for axis in calibration.drive.axes)
    timeout = calibration.limits.serial_timeout
    return f"set and read back: serial timeout {timeout:g} s, motor currents {currents} A"


def _sensor_findings(robot: BoardRobot) -> Iterator[Finding]:
    """Watch the robot at rest for a while, at the servo's pace."""
    clock = WallClock(SERVO_PERIOD)
    observations: list[Observation] = []
    while clock.time < WATCHING:
        clock.tick()
        observations.append(robot.observe())
    battery = {a: robot.boards.state(a).battery for a in robot.boards.addresses}
    yield _battery_finding(battery, robot.calibration)
    for name in SENSORS:
        yield _fresh(name, [getattr(observation, name) for observation in observations])
    yield _rest_finding(observations)
    share = clock.misses / (clock.misses + len(observations))
    slow = "other programs, or an adapter with a long latency timer" if share > MISSED else ""
    value = f"{100.0 * share:.1f} % of the 10 ms cycles missed"
    yield Finding("100 Hz", value, slow, required=False)


def _battery_finding(volts: dict[int, float], calibration: Calibration) -> Finding:
    low, high = calibration.limits.least_battery, calibration.limits.most_battery
    well = all(low <= value <= high for value in volts.values())
    text = ", ".join(f"{value:.1f}" for value in volts.values())
    return Finding("battery", f"{text} V", "" if well else f"needs {low:g} to {high:g} V")


def _fresh(name: str, channels: list[Channel]) -> Finding:
    """Return a channel's last value, and in how many cycles it was usable."""
    what, last = name.replace("_", " "), channels[-1]
    text, factor = SENSORS[name]
    text = text.format(*factor * last.value.astype(float)) if last.usable else last.validity.value
    usable = sum(channel.usable for channel in channels)
    value = f"{text}, fresh in {usable} of {len(channels)} cycles"
    if usable >= FRESH * len(channels):
        return Finding(what, value)
    if not usable:
        value = f"{last.validity.value} in all cycles"
    return Finding(what, value, "check its wiring and its name in --robot")


def _rest_finding(observations: list[Observation]) -> Finding:
    """Check that the encoders are at rest."""
    speeds = [
        float(np.max(np.abs(channel.value)))
        for o in observations
        for channel in (o.wheel_speeds, o.arm_rates)
        if channel.usable
    ]
    if not speeds:
        return Finding("encoders", "no sample", "check the motor boards")
    fastest = float(np.median(speeds))
    moves = "hold the robot still; nothing drives it" if fastest > STILL else ""
    return Finding("encoders", f"at {fastest:.3f} rad/s", moves, required=False)


def _stop_finding(boards: WiredBoards, press_stop: Callable[[], None], patience: float) -> Finding:
    """Check that every board notices the e-stop, and its release."""
    press_stop()
    deaf = _await_stop(boards, pressed=True, patience=patience)
    if deaf:
        remedy = "press it; set S3 of each board to e-stop and wire the switch to all"
        return Finding("e-stop", f"not seen by {deaf}", remedy)
    stuck = _await_stop(boards, pressed=False, patience=patience)
    if stuck:
        remedy = "release it; some firmware wants its power switched off and on"
        return Finding("e-stop", f"still pressed by the report of {stuck}", remedy)
    return Finding("e-stop", "seen and released on every board")


def _await_stop(boards: WiredBoards, pressed: bool, patience: float) -> str:
    """Wait until all boards report it as pressed, or as released; return the others' names."""
    end = time.monotonic() + patience
    while True:
        others = [a for a in boards.addresses if _stopped(boards, a, pressed) != pressed]
        if not others or time.monotonic() >= end:
            return ", ".join(f"{address:#x}" for address in others)
        time.sleep(POLL)


def _stopped(boards: WiredBoards, address: int, pressed: bool) -> bool:
    """Return whether a board is stopped; a silent one counts as the opposite of what it should."""
    try:
        if not pressed:
            boards.reset_e_stop()
        return bool(boards.status(address) & Status.E_STOP)
    except LinkError:
        return not pressed
