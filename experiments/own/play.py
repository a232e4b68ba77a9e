"""``play``: a rover of ours plays a motion, and all that it measures is logged."""

from collections.abc import Mapping

import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from controllers.motion.base_motion import level_of
from controllers.motion.playback import MotionPlayer
from controllers.motion.tipping.look_ahead import LookAhead, Plan
from experiments.harness.contract import ExperimentError
from experiments.harness.robot_option import check_calibrations
from experiments.own.motion_file import read_motion
from experiments.own.play_options import Options
from perception.geometry.arrays import FloatArray
from twin.connect import connect
from twin.description import RobotDescription
from twin.logs.log import Field
from twin.logs.writing import LogWriter
from twin.loop import run as run_loop
from twin.robot import Robot

LONGEST_WAY = 30.0
"""Time that a motion's start is given to be reached [s]."""


def run(options: Options) -> int:
    """Let a rover play a motion, and log it.

    Returns:
        0, or 1 if the motion was not played to its end.

    Raises:
        ExperimentError: If the motion cannot be read, is none for this arm, or may well tip the
            rover over or touch the ground.
        RobotError: If the rover fails; it was stopped.
    """
    check_calibrations(options.robot)
    motion = read_motion(options.motion)
    realism = options.realism or "ideal"
    with connect(options.robot, realism=realism, seed=options.seed or 0) as connection:
        (robot,) = connection.robots.values()
        try:
            stamps, angles = joint_angles(motion, robot.description, robot.name)
        except ValueError as error:
            raise ExperimentError(f"{options.motion}: {error}") from None
        _look_ahead(robot, Plan.of_table(stamps, angles), options)
        player = MotionPlayer(robot.name, stamps, angles, options.approach)
        duration = float(stamps[-1] - stamps[0])
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns) as progress, LogWriter(options.log, connection.settings) as log:
            task = progress.add_task("to the start", total=duration)

            def ended() -> bool:
                what = "playing" if player.played > 0.0 else "to the start"
                progress.update(task, completed=player.played, description=what)
                return player.done

            longest = duration + LONGEST_WAY
            run_loop(connection.robots, [player], connection.clock, [log], longest, ended)
    if not player.done:
        print(f"played {player.played:.1f} of {duration:.1f} s: the start was not reached in time")
        return 1
    print(f"next: log {options.log}, and identify")
    return 0


def _look_ahead(robot: Robot, plan: Plan, options: Options) -> None:
    """Refuse a motion that may well tip the rover over, and tell one that it cannot follow.

    Raises:
        ExperimentError: Naming the probability.
    """
    rng = np.random.default_rng(options.seed or 0)
    found = LookAhead(robot.description).outlook(plan, rng, level_of(robot.observe()))
    for chance, what in (
        (found.tip(), f"tips {robot.name} over"),
        (found.touch(), f"brings the arm of {robot.name} to the ground"),
    ):
        if chance > options.risk:
            raise ExperimentError(
                f"{options.motion}: {what} with {chance:.0%}, more than --risk {options.risk:g}; "
                "change it, or say a larger one"
            )
    if found.strain() > 0.5:  # noqa: PLR2004
        print(f"{options.motion}: faster than the motors of the arm can follow")


def joint_angles(
    motion: Mapping[str, Field], robot: RobotDescription, name: str
) -> tuple[FloatArray, FloatArray]:
    """Return the times (n,) of a motion [s] and the positions (n, joints) of an arm [rad].

    Args:
        motion: Positions of each joint by its name, with or without the robot's.
        robot: Description of the robot.
        name: Its name.

    Raises:
        ValueError: If a joint has none, or goes beyond its limits, or times do not rise.
    """
    if robot.arm is None:
        raise ValueError(f"{name} has no arm to play it")
    joints = robot.arm.joints
    found = {each.removeprefix(f"{name}/"): field for each, field in motion.items()}
    missing = [each.name for each in joints if each.name not in found]
    if missing:
        raise ValueError(
            f"no positions of {', '.join(missing)}; there are {', '.join(motion) or 'none'}"
        )
    stamps = found[joints[0].name].stamps
    if len(stamps) < 2 or not np.all(np.diff(stamps) > 0.0):  # noqa: PLR2004
        raise ValueError("times do not rise")
    columns: list[FloatArray] = []
    for joint in joints:
        field = found[joint.name]
        column = np.interp(stamps, field.stamps, field.values)
        low, high = joint.limits
        if not (np.isfinite(column).all() and low <= column.min() and column.max() <= high):
            raise ValueError(
                f"{joint.name} goes from {column.min():.3g} to {column.max():.3g} rad; "
                f"its limits are {low:.3g} and {high:.3g}"
            )
        columns.append(column)
    return stamps, np.column_stack(columns)
