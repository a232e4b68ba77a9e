"""Layouts of the rerun viewer."""

from collections.abc import Sequence

import rerun.blueprint as rrb


def default_blueprint(
    robots: Sequence[str], extra: Sequence[rrb.View | rrb.Container] = ()
) -> rrb.Blueprint:
    """Return the layout of the scene, each robot's images and curves, and further views.

    Args:
        robots: Names of the robots.
        extra: Further views, such as estimates; without any, all of ``excitation`` and
            ``estimates`` is shown.
    """
    tabs = [_robot_tab(name) for name in robots]
    below = list(extra) or [
        rrb.TimeSeriesView(origin="excitation", name="Excitation"),
        rrb.TimeSeriesView(origin="estimates", name="Estimates"),
    ]
    scene = scene_view("world", "Scene", (1.3, -1.3, 0.9), (0.0, 0.1, 0.1))
    return side_by_side(
        rrb.Vertical(scene, rrb.Horizontal(*below), row_shares=[3, 2]),
        rrb.Tabs(*tabs) if tabs else rrb.TimeSeriesView(origin="/", name="Curves"),
    )


def task_blueprint(
    robot: str,
    position: tuple[float, float, float],
    target: tuple[float, float, float],
    views: Sequence[rrb.View | rrb.Container],
) -> rrb.Blueprint:
    """Return the layout of a task that one robot views: the scene, its images, and other views.

    Args:
        robot: Name of the robot with the cameras.
        position: Position of the viewer's camera [m].
        target: Point that the viewer's camera is directed at [m].
        views: Views in the right column, from top to bottom.
    """
    scene = scene_view("world", "Scene", position, target)
    return side_by_side(
        rrb.Vertical(scene, _images(robot, f"{robot}'s "), row_shares=[3, 2]), rrb.Vertical(*views)
    )


def scene_view(
    origin: str,
    name: str,
    position: tuple[float, float, float],
    target: tuple[float, float, float],
) -> rrb.Spatial3DView:
    """Return a view of a scene in space.

    Args:
        origin: Entity path of the scene.
        name: Title of the view.
        position: Position of the viewer's camera [m].
        target: Point that the viewer's camera is directed at [m].
    """
    controls = rrb.EyeControls3D(position=position, look_target=target)
    return rrb.Spatial3DView(origin=origin, name=name, eye_controls=controls)


def side_by_side(main: rrb.View | rrb.Container, beside: rrb.View | rrb.Container) -> rrb.Blueprint:
    """Return the layout of a main view on the left and smaller ones on the right.

    Args:
        main: View or container that takes three fifths of the width.
        beside: View or container that takes the rest.
    """
    return content_alone(rrb.Horizontal(main, beside, column_shares=[3, 2]))


def content_alone(content: rrb.View | rrb.Container) -> rrb.Blueprint:
    """Return a blueprint whose viewer shows the content and hides its own panels.

    Args:
        content: View or container that fills the window, above the collapsed timeline.
    """
    return rrb.Blueprint(
        content,
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _robot_tab(name: str) -> rrb.Container:
    views = [
        _images(name, ""),
        rrb.TimeSeriesView(origin=f"{name}/sensors/inclinometer", name="Inclinometer [rad]"),
        rrb.TimeSeriesView(origin=f"{name}/sensors/arm_base_wrench", name="Wrench [N, N m]"),
        rrb.TimeSeriesView(origin=f"{name}/sensors/arm_angles", name="Arm angles [rad]"),
        rrb.TimeSeriesView(origin=f"{name}/sensors/wheel_speeds", name="Wheel speeds [rad/s]"),
        rrb.TimeSeriesView(origin=f"{name}/duty", name="Duty"),
    ]
    return rrb.Vertical(*views, name=name)


def _images(robot: str, prefix: str) -> rrb.Container:
    return rrb.Horizontal(
        *(
            rrb.Spatial2DView(origin=f"{robot}/stereo/{side}", name=f"{prefix}{side} camera")
            for side in ("left", "right")
        )
    )
