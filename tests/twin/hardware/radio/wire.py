"""A radio whose bytes the test carries by hand, and links run in virtual time."""

from collections import deque

import numpy as np

from twin.hardware.radio.framed_radio import FramedConfig, FramedLink


class Wire:
    """A channel whose bytes the test carries by hand."""

    def __init__(self):
        self.time = 0.0
        self.out = deque()
        self.into = b""

    def now(self):
        return self.time

    def write(self, data):
        self.out.append(bytes(data))

    def read(self):
        data, self.into = self.into, b""
        return data


def framed(seed=0, **numbers):
    """A link on a wire carried by hand, with a line that is never busy."""
    wire = Wire()
    config = FramedConfig(**{"baud": 10**9, **numbers})
    return FramedLink(wire, np.random.default_rng(seed), config), wire


def carry(source, target):
    """Carry everything that was written."""
    target.into += b"".join(source.out)
    source.out.clear()


def pump(modems, links, until, each=None):
    """Run both links in virtual time; return what each end was given."""
    messages, outcomes = ([], []), ([], [])
    while modems.time < until:
        for index, link in enumerate(links):
            polled = link.poll()
            messages[index].extend(polled.messages)
            outcomes[index].extend(polled.outcomes)
        if each is not None:
            each()
        event = min(modems.next_arrival(), *(link.next_event() for link in links))
        modems.time = min(max(modems.time, event), until)
    return messages, outcomes
