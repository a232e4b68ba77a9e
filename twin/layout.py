"""How the rerun viewer shows a run."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb


def default_blueprint(
    robots: Sequence[str], extra: Sequence[rrb.View | rrb.Container] = ()
) -> rrb.Blueprint:
    """Return the layout: the scene, each robot's eyes and curves, and what experiments add.

    Args:
        robots: Names of the robots.
        extra: Views beside them, such as estimates; None given shows all of ``excitation`` and
            ``estimates``.
    """
    tabs = [_robot_tab(name) for name in robots]
    below = list(extra) or [
        rrb.TimeSeriesView(origin="excitation", name="Excitation"),
        rrb.TimeSeriesView(origin="estimates", name="Estimates"),
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    origin="world",
                    name="Scene",
                    eye_controls=rrb.EyeControls3D(
                        position=(1.3, -1.3, 0.9), look_target=(0.0, 0.1, 0.1)
                    ),
                ),
                rrb.Horizontal(*below),
                row_shares=[3, 2],
            ),
            rrb.Tabs(*tabs) if tabs else rrb.TimeSeriesView(origin="/", name="Curves"),
            column_shares=[3, 2],
        ),
        *_panels(),
    )


def task_blueprint(
    watcher: str,
    position: tuple[float, float, float],
    target: tuple[float, float, float],
    views: Sequence[rrb.View | rrb.Container],
) -> rrb.Blueprint:
    """Return the layout of a task that one robot watches: the scene, its eyes, and other views.

    Args:
        watcher: Name of the robot with the eyes.
        position: From where the scene is shown [m].
        target: What is in its middle [m].
        views: Beside them, from top to bottom.
    """
    eyes = [
        rrb.Spatial2DView(origin=f"{watcher}/stereo/{side}", name=f"{watcher}'s {side} eye")
        for side in ("left", "right")
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    origin="world",
                    name="Scene",
                    eye_controls=rrb.EyeControls3D(position=position, look_target=target),
                ),
                rrb.Horizontal(*eyes),
                row_shares=[3, 2],
            ),
            rrb.Vertical(*views),
            column_shares=[3, 2],
        ),
        *_panels(),
    )


def _panels() -> tuple[rrb.TimePanel, rrb.BlueprintPanel, rrb.SelectionPanel]:
    return (
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _robot_tab(name: str) -> rrb.Container:
    views = [
        rrb.Horizontal(
            *(
                rrb.Spatial2DView(origin=f"{name}/stereo/{side}", name=f"{side} eye")
                for side in ("left", "right")
            )
        ),
        rrb.TimeSeriesView(origin=f"{name}/sensors/inclinometer", name="Inclinometer [rad]"),
        rrb.TimeSeriesView(origin=f"{name}/sensors/arm_base_wrench", name="Wrench [N, N m]"),
        rrb.TimeSeriesView(origin=f"{name}/sensors/arm_angles", name="Arm angles [rad]"),
        rrb.TimeSeriesView(origin=f"{name}/sensors/wheel_speeds", name="Wheel speeds [rad/s]"),
        rrb.TimeSeriesView(origin=f"{name}/duty", name="Duty"),
    ]
    return rrb.Vertical(*views, name=name)
