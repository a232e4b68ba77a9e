import math

import numpy as np
import pytest

from models.compose import RobotPlacement
from models.datasheets import HARSH_RADIO, RADIO
from twin.connect import LineConfig, connect
from twin.hardware.emulator.modem import ModemConfig
from twin.hardware.radio.frames import Frame, encode_frame

PAIR = (RobotPlacement("rover1"), RobotPlacement("rover2", (1.5, 0.0)))


def exchange(connection, ticks):
    """Send a numbered message every tenth tick; return (tick, message) as they arrive."""
    first, second = connection.links["rover1"], connection.links["rover2"]
    received = []
    for tick in range(ticks):
        if tick % 10 == 0:
            first.send_latest(b"t" + bytes([tick]))
        first.poll()
        received += [(tick, message[1]) for message in second.poll().messages]
        connection.clock.tick()
    return received


@pytest.mark.parametrize("target", ["sim", "quantised"])
def test_message_arrives_after_the_modems_time_for_its_bytes(target):
    with connect(target, robots=PAIR) as connection:
        received = exchange(connection, 50)
    assert [sent for _, sent in received] == [0, 10, 20, 30, 40]
    # About 12 bytes of a frame at 960 a second, and 5 ms of delay.
    assert all(tick - sent == 2 for tick, sent in received)


@pytest.mark.parametrize(("realism", "radio"), [("default", RADIO), ("harsh", HARSH_RADIO)])
def test_realism_sets_the_radios_delay(realism, radio):
    with connect("sim", robots=PAIR, realism=realism, seed=1) as connection:
        received = exchange(connection, 250)
    assert len(received) > 15
    size = len(encode_frame(Frame(2, 0, 1, 1, b"t0")))
    late = math.ceil(100.0 * (size / 960 + radio.delay))
    assert all(tick - sent == late for tick, sent in received)


def test_radio_rng_decides_what_is_lost_and_sensors_do_not():
    def losses(seed, radio):
        with connect(
            "sim",
            robots=PAIR,
            seed=seed,
            lines=LineConfig(
                modems=ModemConfig(error_rate=0.05), radio_rng=np.random.default_rng(radio)
            ),
        ) as connection:
            return exchange(connection, 250)

    assert losses(1, 5) == losses(2, 5) != losses(1, 6)


def test_robot_alone_has_no_radio():
    with connect("sim") as connection:
        assert connection.links == {}
