"""Public clients of the RoboClaw drive the emulated board: whatever they say, the board holds.

Not compared: PWM mode by basicmicro, which sends one for each motor where the manual and the other
client send one for both.
"""

import contextlib

import pytest
from basicmicro import Basicmicro
from basicmicro.commands import Commands
from tcr_roboclaw import Roboclaw

from tests.twin.hardware.roboclaw.wire import BAUD, PtyWire, boards_on_a_line
from twin.hardware.roboclaw.codec import Status

ADDRESS = 0x82
COUNTS = (0, 1, -1, 2**31 - 1, -(2**31))
DUTIES = (0, 1, -1, 32767, -32767)
RATES = (0, 38400, -38400, 27962 * 38400, -27962 * 38400)  # [1/s] Of 300, by which raw ones go.
LONGS = (0, 1, 2**31, 2**32 - 1)
PERIOD = 2.0**-7  # [s] Divides without rounding.


def unsigned(value):
    return value % 2**32


@contextlib.contextmanager
def emulated():
    """Yield a board, beside others on its line, and its port."""
    boards, line = boards_on_a_line((0x80, 0x81, ADDRESS))
    # No clock: a busy machine may pause longer between two bytes than the board would wait.
    with PtyWire(line, clock=lambda: 0.0) as wire:
        yield boards[2], wire.port.name
    assert not any(board.obeyed for board in boards[:2])


@pytest.fixture
def basicmicro():
    with emulated() as (board, port), Basicmicro(port, BAUD) as client:
        yield client, board


@pytest.fixture
def tcr():
    with emulated() as (board, port):
        client = Roboclaw(port, BAUD, ADDRESS)
        client.open()
        yield client, board
        client._port.close()


def compare(steps, offered):
    """Check that each said value is the board's; return the commands compared."""
    compared = set()
    for command, said, held in steps:
        assert said == held, command
        compared.add(command)
    assert compared <= set(offered)
    return compared


def turn(board, rates):
    """Let the motors turn for a tick at rates [1/s]."""
    for number, rate in enumerate(rates):
        board.motors.counts[number] += round(rate * PERIOD)
    board.tick(0.0, PERIOD)


def set_counts(board, one, two):
    """Let the encoders stand somewhere, as after many ticks."""
    board.motors.counts = [one, two]
    for channel, count in zip(board.channels, board.motors.counts, strict=True):
        channel.offset, channel.last_count, channel.turn = 0, count, count >> 32


def pairs(values):
    """Each value in each place."""
    return list(zip(values, values[1:] + values[:1]))


def motor_truth(board):
    """Walk what the motors do over its range; yield the name of each thing to be read."""
    for one, two in pairs(COUNTS):
        set_counts(board, one, two)
        yield "encoders", (one, two)
    for volts in (10.0, 12.0, 34.0, 6553.5):
        board.motors.voltage = volts
        yield "voltage", round(10 * volts)
    board.motors.voltage = 12.0
    for one, two in pairs((0, 1, -1, 32767, -32768)):
        board.motors.currents = [0.01 * one, 0.01 * two]
        yield "currents", (one, two)
    for one, two in pairs(RATES):
        turn(board, (one, two))
        yield "speeds", (one, two)
    for logic, temperature in ((0, 65535), (50, 250), (65535, 0)):
        board.motors.logic, board.motors.temperature = logic, temperature
        yield "surroundings", (logic, temperature)
    for bit in Status:
        board.status = bit
        yield "status", int(bit)
    board.status = Status.NORMAL


# basicmicro


def basicmicro_reads(client, board):
    c = Commands
    for name, truth in motor_truth(board):
        if name == "encoders":
            one, two = map(unsigned, truth)
            yield c.GETM1ENC, client.ReadEncM1(ADDRESS), (True, one, 0)
            yield c.GETM2ENC, client.ReadEncM2(ADDRESS), (True, two, 0)
            yield c.GETENCODERS, client.GetEncoders(ADDRESS), (True, one, two)
        elif name == "voltage":
            yield c.GETMBATT, client.ReadMainBatteryVoltage(ADDRESS), (True, truth)
        elif name == "currents":
            yield c.GETCURRENTS, client.ReadCurrents(ADDRESS), (True, *truth)
        elif name == "surroundings":
            yield c.GETLBATT, client.ReadLogicBatteryVoltage(ADDRESS), (True, truth[0])
            yield c.GETTEMP, client.ReadTemp(ADDRESS), (True, truth[1])
        elif name == "speeds":
            one, two = truth
            yield c.GETM1SPEED, client.ReadSpeedM1(ADDRESS), (True, unsigned(one), one < 0)
            yield c.GETM2SPEED, client.ReadSpeedM2(ADDRESS), (True, unsigned(two), two < 0)
            yield c.GETISPEEDS, client.GetISpeeds(ADDRESS), (True, unsigned(one), unsigned(two))
        else:
            yield c.GETERROR, client.ReadError(ADDRESS), (True, truth)
    version = (True, "USB Roboclaw 2x15a v4.3.6\n")
    yield c.GETVERSION, client.ReadVersion(ADDRESS), version


def basicmicro_settings(client, board):
    c, (one, two) = Commands, board.channels
    for steps in (0, 1, 255):
        yield c.SETTIMEOUT, client.SetTimeout(ADDRESS, steps / 10), board.timeout == steps
        yield c.GETTIMEOUT, client.GetTimeout(ADDRESS), (True, board.timeout / 10)
    for count in COUNTS:
        done = client.SetEncM1(ADDRESS, count)
        yield c.SETM1ENCCOUNT, (done, count), (True, board.encoders()[0])
        done = client.SetEncM2(ADDRESS, count)
        yield c.SETM2ENCCOUNT, (done, count), (True, board.encoders()[1])
    done = client.ResetEncoders(ADDRESS)
    yield c.RESETENC, (done, 0, 0), (True, board.encoders()[0], board.encoders()[1])
    for p, i, d, full in ((0, 1, 2**32 - 1, 44000), (2**32 - 1, 0, 1, 2**32 - 1)):
        gains = p / 65536, i / 65536, d / 65536, full
        done = client.SetM1VelocityPID(ADDRESS, *gains)
        yield c.SETM1PID, (done, p, i, d, full), (True, *one.gains)
        done = client.SetM2VelocityPID(ADDRESS, *gains)
        yield c.SETM2PID, (done, p, i, d, full), (True, *two.gains)
        yield c.READM1PID, client.ReadM1VelocityPID(ADDRESS), (True, *gains)
        yield c.READM2PID, client.ReadM2VelocityPID(ADDRESS), (True, *gains)
    for most in LONGS:
        done = client.SetM1MaxCurrent(ADDRESS, most, 0)
        yield c.SETM1MAXCURRENT, (done, most), (True, one.current_limit)
        yield c.GETM1MAXCURRENT, client.ReadM1MaxCurrent(ADDRESS), (True, most, 0)
        done = client.SetM2MaxCurrent(ADDRESS, most // 2, 0)
        yield c.SETM2MAXCURRENT, (done, most // 2), (True, two.current_limit)
        yield c.GETM2MAXCURRENT, client.ReadM2MaxCurrent(ADDRESS), (True, most // 2, 0)
    board.status = Status.E_STOP | Status.TEMPERATURE_WARNING
    done = client.ResetEStop(ADDRESS)
    yield c.RESETESTOP, (done, Status.TEMPERATURE_WARNING), (True, board.status)


def basicmicro_drives(client, board):
    c, (one, two) = Commands, board.channels
    for first, second in pairs(DUTIES):
        done = client.DutyM1(ADDRESS, first) and client.DutyM2(ADDRESS, second)
        yield c.M1DUTY, (done, first), (True, one.duty)
        yield c.M2DUTY, (done, second), (True, two.duty)
        yield c.GETPWMS, client.ReadPWMs(ADDRESS), (True, first, second)
        done = client.DutyM1M2(ADDRESS, second, first)
        yield c.MIXEDDUTY, (done, second, first), (True, one.duty, two.duty)
    for first, second in pairs(COUNTS):
        done = client.SpeedM1(ADDRESS, first) and client.SpeedM2(ADDRESS, second)
        yield c.M1SPEED, (done, first), (True, one.target_speed)
        yield c.M2SPEED, (done, second), (True, two.target_speed)
        done = client.SpeedM1M2(ADDRESS, second, first)
        yield c.MIXEDSPEED, (done, second, first), (True, one.target_speed, two.target_speed)
        fast, slow = (5, 2**32 - 1, 6), (7, 0, 8)
        done = client.SpeedAccelDeccelPositionM1(ADDRESS, *fast, first, 1)
        yield c.M1SPEEDACCELDECCELPOS, (done, (first, fast[1])), (True, one.target_position)
        done = client.SpeedAccelDeccelPositionM2(ADDRESS, *slow, second, 0)
        yield c.M2SPEEDACCELDECCELPOS, (done, (second, slow[1])), (True, two.target_position)
        done = client.SpeedAccelDeccelPositionM1M2(ADDRESS, *slow, second, *fast, first, 1)
        wanted = (second, slow[1]), (first, fast[1])
        held = one.target_position, two.target_position
        yield c.MIXEDSPEEDACCELDECCELPOS, (done, *wanted), (True, *held)


def test_basicmicro_agrees_with_the_board_on_every_command(basicmicro):
    client, board = basicmicro
    compared = set()
    for part in (basicmicro_reads, basicmicro_settings, basicmicro_drives):
        compared |= compare(part(client, board), Commands)
    assert len(compared) == 36


# tcr-roboclaw


def tcr_reads(client, board):
    c = Roboclaw.CMD
    for name, truth in motor_truth(board):
        if name == "encoders":
            one, two = truth
            yield c.GETM1ENC, client.ReadEncM1(), (1, one, 0)
            yield c.GETM2ENC, client.ReadEncM2(), (1, two, 0)
            yield c.GETENCCOUNTERS, client.GetEncoderCounters(), [1, *map(unsigned, truth)]
        elif name == "voltage":
            yield c.GETMBATTVOLT, client.ReadMainBatteryVoltage(), (1, truth)
        elif name == "currents":
            yield c.GETCURRENTS, client.ReadCurrents(), (1, *truth)
        elif name == "surroundings":
            yield c.GETLBATTVOLT, client.ReadLogicBatteryVoltage(), (1, truth[0])
            yield c.GETTEMP, client.ReadTemp(), (1, truth[1])
        elif name == "speeds":
            one, two = truth
            yield c.GETM1SPEED, client.ReadSpeedM1(), (1, one, one < 0)
            yield c.GETM2SPEED, client.ReadSpeedM2(), (1, two, two < 0)
            yield c.GETISPEEDCOUNTERS, client.GetISpeedCounters(), [1, *map(unsigned, truth)]
        else:
            yield c.GETERROR, client.ReadError(), (1, truth)
    yield c.GETFWVERSION, client.ReadVersion(), (1, "USB Roboclaw 2x15a v4.3.6\n")


def tcr_settings(client, board):
    c, (one, two) = Roboclaw.CMD, board.channels
    for steps in (0, 1, 255):
        yield c.SETSERIALTIMEOUT, client.SetSerialTimeout(steps), board.timeout == steps
        yield c.GETSERIALTIMEOUT, client.ReadSerialTimeout(), (1, board.timeout)
    for count in COUNTS:
        done = client.SetEncM1(count)
        yield c.SETM1ENCCOUNT, (done, count), (True, board.encoders()[0])
        done = client.SetEncM2(count)
        yield c.SETM2ENCCOUNT, (done, count), (True, board.encoders()[1])
    done = client.ResetEncoders()
    yield c.RESETENC, (done, 0, 0), (True, board.encoders()[0], board.encoders()[1])
    for p, i, d, full in ((0, 1, 2**32 - 1, 44000), (2**32 - 1, 0, 1, 2**32 - 1)):
        gains = p / 65536, i / 65536, d / 65536, full
        done = client.SetM1VelocityPID(*gains)
        yield c.SETM1PID, (done, p, i, d, full), (True, *one.gains)
        done = client.SetM2VelocityPID(*gains)
        yield c.SETM2PID, (done, p, i, d, full), (True, *two.gains)
        yield c.READM1PID, client.ReadM1VelocityPID(), [1, *gains]
        yield c.READM2PID, client.ReadM2VelocityPID(), [1, *gains]
    for most in LONGS:
        done = client.SetM1MaxCurrent(most)
        yield c.SETM1MAXCURRENT, (done, most), (True, one.current_limit)
        yield c.GETM1MAXCURRENT, client.ReadM1MaxCurrent(), (1, most)
        done = client.SetM2MaxCurrent(most // 2)
        yield c.SETM2MAXCURRENT, (done, most // 2), (True, two.current_limit)
        yield c.GETM2MAXCURRENT, client.ReadM2MaxCurrent(), (1, most // 2)
    for mode in (1, 0):
        yield c.SETPWMMODE, client.SetPWMMode(mode), board.pwm_mode == mode
        yield c.GETPWMMODE, client.GetPWMMode(), (1, mode)


def tcr_drives(client, board):
    c, (one, two) = Roboclaw.CMD, board.channels
    for first, second in pairs(DUTIES):
        done = client.DutyM1(first) and client.DutyM2(second)
        yield c.M1DUTY, (done, first), (True, one.duty)
        yield c.M2DUTY, (done, second), (True, two.duty)
        yield c.GETPWMS, client.ReadPWMs(), (1, first, second)
        done = client.DutyM1M2(second, first)
        yield c.MIXEDDUTY, (done, second, first), (True, one.duty, two.duty)
    for first, second in pairs(COUNTS):
        done = client.SpeedM1(first) and client.SpeedM2(second)
        yield c.M1SPEED, (done, first), (True, one.target_speed)
        yield c.M2SPEED, (done, second), (True, two.target_speed)
        done = client.SpeedM1M2(second, first)
        yield c.MIXEDSPEED, (done, second, first), (True, one.target_speed, two.target_speed)
        fast, slow = (5, 2**32 - 1, 6), (7, 0, 8)
        done = client.BuffSpeedAccelDeccelPositionM1(*fast, first, 1)
        wanted = done, (first, fast[1])
        yield c.BUF_M1SPEEDACCELDECCELPOS, wanted, (True, one.target_position)
        done = client.BuffSpeedAccelDeccelPositionM2(*slow, second, 0)
        wanted = done, (second, slow[1])
        yield c.BUF_M2SPEEDACCELDECCELPOS, wanted, (True, two.target_position)
        done = client.BuffSpeedAccelDeccelPositionM1M2(*slow, second, *fast, first, 1)
        wanted = done, (second, slow[1]), (first, fast[1])
        held = one.target_position, two.target_position
        yield c.BUF_MIXEDSPEEDACCELDECCELPOS, wanted, (True, *held)


def test_tcr_roboclaw_agrees_with_the_board_on_every_command(tcr):
    client, board = tcr
    offered = {value for name, value in vars(Roboclaw.CMD).items() if name.isupper()}
    compared = set()
    for part in (tcr_reads, tcr_settings, tcr_drives):
        compared |= compare(part(client, board), offered)
    assert len(compared) == 37
