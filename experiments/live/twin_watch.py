"""A twin beside a rover, with all that is kept and shown of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.live.twin_beside import Named, TwinBeside
from experiments.live.twin_folder import TwinFolder
from experiments.live.twin_report import TwinRecording, print_found, write_report
from models.compose import RobotPlacement
from twin.logs.ticks import RoverTick


class TwinState(NamedTuple):
    """What a twin tells the process that drives.

    Attributes:
        time: Time of the rover that it has come to [s].
        surprise: Root mean square of the innovations of all channels over their deviations.
        learning: Whether it still learns its rover only.
        named: Changes that it named in this run.
    """

    time: float
    surprise: float
    learning: bool
    named: tuple[Named, ...]


class Watch:
    """A twin, with all that is kept of it.

    Args:
        folder: Its folder.
        twin: The twin.
        placed: The rover.
        recording: File of its recording, ``.rrd``.
    """

    def __init__(
        self, folder: TwinFolder, twin: TwinBeside, placed: RobotPlacement, recording: Path
    ) -> None:
        self._folder, self._twin = folder, twin
        self._recording = TwinRecording(recording, placed, twin)
        self._named = 0

    @property
    def found(self) -> bool:
        """Whether there was a block of ticks."""
        return bool(self._twin.blocks)

    @property
    def state(self) -> TwinState:
        """What there is to tell, once there was a block."""
        last, named = self._twin.blocks[-1], tuple(self._twin.named)
        surprise = float(np.sqrt(np.nanmean(np.square(last.surprise))))
        return TwinState(last.time, surprise, bool(np.isnan(last.evidence)), named)

    def step(self, tick: RoverTick) -> bool:
        """Take a tick, and return whether there is something to tell."""
        twin, blocks = self._twin, len(self._twin.blocks)
        twin.step(tick)
        self._recording.add(tick)
        if len(twin.blocks) == blocks:
            return False
        self._recording.add_block(twin.blocks[-1])
        self._folder.add(twin.blocks, twin.memory)
        for named in twin.named[self._named :]:
            self._folder.add_named(named)
            self._recording.add_named(named)
        self._named = len(twin.named)
        return True

    def close(self, more: Mapping[str, Any]) -> None:
        """Write figures and numbers, and print what was found.

        Args:
            more: Further entries of ``live.json``.
        """
        self._recording.close()
        folder, twin = self._folder, self._twin
        blocks, named = [*folder.blocks, *twin.blocks], [*folder.named, *twin.named]
        if blocks:
            write_report(blocks, named, twin, folder.path, more)
        if twin.blocks:
            print_found(twin)
            print(
                f"next: look at {folder.path / 'deviations.png'}, or rerun {self._recording.path}"
            )
