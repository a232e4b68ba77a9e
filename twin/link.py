"""The radio between two robots, as a controller uses it.

`twin.connect.connect` gives each robot its end, simulated or on a real modem. Nothing here waits: a
controller calls `poll` once a tick.
"""

from typing import NamedTuple, Protocol

MESSAGE_LIMIT = 64
"""Longest message [bytes]; at one error in 100 bytes every second frame of one still arrives."""


class RadioError(ValueError):
    """A message that the radio cannot send, or cannot decode."""


class Outcome(NamedTuple):
    """Fate of a message that was sent.

    Attributes:
        ticket: Ticket that `Link.send` returned.
        confirmed: True if it arrived; False if it could not be confirmed in time (it may have
            arrived all the same: its acknowledgement can be lost, too).
    """

    ticket: int
    confirmed: bool


class Polled(NamedTuple):
    """Result of a call of `Link.poll`.

    Attributes:
        messages: Received messages, in order.
        outcomes: Outcomes of messages sent; each ticket appears once, sooner or later.
    """

    messages: list[bytes]
    outcomes: list[Outcome]


class LatestLink(Protocol):
    """One robot's end of the radio, for values that the next one replaces."""

    def send_latest(self, message: bytes) -> None:
        """Send a value once; one that still waits with the same first byte (its type) is replaced.

        Raises:
            RadioError: If the message is empty or too long.
        """
        ...

    def poll(self) -> Polled:
        """Transmit what the line has capacity for, and return what has arrived by now."""
        ...


class Link(LatestLink, Protocol):
    """One robot's end of the radio."""

    def send(self, message: bytes) -> int:
        """Queue a message that must arrive: in order, once, or reported as unconfirmed.

        Returns:
            The ticket that an `Outcome` of a later `poll` carries.

        Raises:
            RadioError: If the message is empty or too long, or too many wait to be sent.
        """
        ...
