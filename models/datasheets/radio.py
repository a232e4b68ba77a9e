"""The radio modems between the robots."""

import dataclasses
from typing import Final


@dataclasses.dataclass(frozen=True)
class RadioSheet:
    """A pair of 9600-baud radio modems (Thesis app. D names no make).

    The default is MaxStream's 9XStream of 2001 (OEM module manual v2.8, experiment 1, modules of
    9600 baud): a byte takes 16.2 ms once the modules hop in step, and 48.4 ms with the header that
    brings them in step. Another make, SATELLINE-3AS (user guide, table 18.2), takes 42 to 44 ms.
    """

    delay: float = 16.2e-3  # From a byte's last bit in to the same out [s] (9XStream, in step)
    # Assumption: well within range. Makers state their sensitivity at 1e-3 (SATELLINE) or less.
    bit_error_rate: float = 1e-5
    packet_loss: float = 0.01  # Share of packets. Assumption: interference, and fading in motion


RADIO: Final = RadioSheet()
HARSH_RADIO: Final = RadioSheet(
    delay=48.4e-3,  # 9XStream, every packet with the header
    # Assumption: near the end of the range, rocks in the line of sight.
    bit_error_rate=1e-4,
    packet_loss=0.05,
)
