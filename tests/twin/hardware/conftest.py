"""The time that a client of a device spends waiting, which no busy machine makes longer."""

import select
import time

import pytest

from twin.hardware import serial_link
from twin.hardware.force_torque import net_ft


class WaitingTime:
    """For how long the clients of this thread wanted to wait for a device, and did.

    A busy machine lets a wait end late; that is not the call's doing. That calls do not spin
    instead of waiting is seen in virtual time, where each step takes some.
    """

    def __init__(self):
        self.waited = 0.0

    def select(self, readers, writers, others, timeout):
        begin = time.perf_counter()
        ready = select.select(readers, writers, others, timeout)
        self.waited += min(timeout, time.perf_counter() - begin)
        return ready

    def __call__(self):
        return self.waited


@pytest.fixture
def waiting_time(monkeypatch):
    clock = WaitingTime()
    for client in (serial_link, net_ft):
        monkeypatch.setattr(client, "select", clock)
    return clock
