"""CPU time of a mission's search: physics, drawing and perception of two rovers."""

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from typing import Any

from controllers.mapping.shared_map import SharedMap
from controllers.mapping.visual_odometry import VisualOdometry
from controllers.mission.navigator import Navigator
from experiments.bench.bench_options import Options
from experiments.harness.output import Output
from experiments.mission.trial import MissionTrial, prepared
from perception.elevation.map import ElevationMap
from perception.stereo.matching import StereoMatcher
from twin.camera import StereoHead
from twin.loop import run
from twin.simulation import Simulation

SEED = 1  # One of those for development.
SETTLING = 20.0  # Robot time of the identification, and of loading compiled functions [s].
BOUND = 0.5
PARTS: dict[str, tuple[tuple[type, str], ...]] = {
    "physics and sensors": ((Simulation, "tick"),),
    "drawing": ((StereoHead, "draw"),),
    "stereo matching": ((StereoMatcher, "match"),),
    "visual odometry": ((VisualOdometry, "see"),),
    "markers": ((SharedMap, "locate"), (SharedMap, "sight")),
    "elevation map": ((ElevationMap, "insert"),),
    "paths": ((Navigator, "lengths_to"), (Navigator, "path_to")),
}
"""Methods that each part is the time of; none calls one of another part."""


def bench_mission(options: Options, output: Output) -> None:
    """Measure the CPU time of each part of a mission's search, on one core.

    Args:
        options: ``quick`` ends it after 10 s.
        output: Receives ``mission_cpu``, in seconds for each second of robot time, and
            ``mission_cpu/<part>``.
    """
    seconds = 10.0 if options.quick else 100.0
    with prepared(MissionTrial(SEED)) as mission:
        robots, clock = mission.connection.robots, mission.connection.clock
        run(robots, [mission.team], clock, duration=SETTLING)
        with timed_parts() as spent:
            begin = time.process_time()
            run(robots, [mission.team], clock, duration=seconds)
            total = time.process_time() - begin
    spent["controllers and the rest"] = total - sum(spent.values())
    for part, used in spent.items():
        output.measure(f"mission_cpu/{part}", used / seconds)
    output.measure("mission_cpu", total / seconds)
    output.check(
        "search of a mission, CPU time over robot time",
        total / seconds,
        f"<= {BOUND}",
        total / seconds <= BOUND,
    )


@contextlib.contextmanager
def timed_parts() -> Iterator[dict[str, float]]:
    """Yield the CPU time of each of `PARTS` [s], which grows while they run."""
    spent = dict.fromkeys(PARTS, 0.0)
    methods = [(part, *method) for part, parts in PARTS.items() for method in parts]
    before = [getattr(owner, name) for _, owner, name in methods]

    def timed(part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(method)
        def measured(*args: Any, **options: Any) -> Any:
            begin = time.process_time()
            try:
                return method(*args, **options)
            finally:
                spent[part] += time.process_time() - begin

        return measured

    try:
        for (part, owner, name), method in zip(methods, before):
            setattr(owner, name, timed(part, method))
        yield spent
    finally:
        for (_, owner, name), method in zip(methods, before):
            setattr(owner, name, method)
