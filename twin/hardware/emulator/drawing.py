"""Stereo pairs drawn by a process of their own, so that emulated boards answer meanwhile."""

import multiprocessing
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor

from perception.geometry.arrays import ImageArray
from twin.camera import StereoHead, TakenPair
from twin.hardware.background import end_with_parent

_HEADS: dict[str, StereoHead] = {}
"""In the drawing process: the robots' stereo heads."""


class DrawingProcess:
    """A process that draws the stereo pairs of a scene.

    Args:
        heads: The scene's stereo heads, by robot name.
    """

    def __init__(self, heads: Mapping[str, StereoHead]) -> None:
        self._heads = heads
        spawn = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, spawn, _take_heads, (dict(heads), os.getpid()))
        for name in heads:
            # The first picture takes a second; nobody has time for it later.
            self.newest(name)().result()

    def newest(self, robot: str) -> Callable[[], Future[ImageArray]]:
        """Return what has a robot's newest pair drawn, now or later.

        Args:
            robot: Name of the robot.
        """
        latest = self._heads[robot].latest
        return lambda: self._pool.submit(_draw, robot, latest)

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(cancel_futures=True)


def _take_heads(heads: dict[str, StereoHead], parent: int) -> None:
    end_with_parent(parent)
    _HEADS.update(heads)


def _draw(robot: str, taken: TakenPair) -> ImageArray:
    return _HEADS[robot].draw(taken)
