"""``appe-workspace``: all words of five BRAID stages, the poses they reach, and the stage itself.

Figure E-5, the stage's residual and symmetry, the thesis' repaired equations beside the exact ones,
and the flexures that the joints' angles ask for (E-1, E-2). All lengths are in radii of the discs.
"""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.arm.chain import all_words, count_poses, forward, reduced_count
from controllers.braid.arm.flexure import MATERIALS, greatest_thickness, joint_angles, stiffness
from controllers.braid.arm.stage import (
    StageGeometry,
    closure_residual,
    stage_pose,
    state_lengths,
    state_poses,
)
from controllers.braid.arm.thesis_stage import thesis_stage_pose
from experiments.appe.arm.workspace_options import Options
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray

EXACT = 1e-12
EXTENSIONS = (0.05, 0.1, 0.2, 0.3)
LENGTHS, QUICK_LENGTHS = 100_000, 10_000
MIRRORED = (0, 1, 6, 7)
"""States whose legs 2 and 3 are alike."""
STRIP_LENGTH, STRIP_WIDTH, DISC = 5e-3, 10e-3, 50e-3
"""Sizes of the flexures in the table, and the disc's radius [m]: assumptions."""


def run(options: Options, output: Output) -> None:
    """List all words, count their poses, and check the stage.

    Args:
        options: ``quick`` takes fewer random legs for the residual.
        output: Receives ``unique_poses/<n>``, ``stage_residual``, ``symmetry_error`` and
            ``thesis_stage_error/<extension>``.
    """
    geometry = StageGeometry(1.0, 1.0, 1.0 + options.extension)
    poses = forward(state_poses(geometry), all_words(options.stages))
    unique = count_poses(poses)
    output.measure(f"unique_poses/{options.stages}", unique, thesis=8**options.stages)
    expected = reduced_count(options.stages)
    name = f"different poses of {options.stages} stages"
    output.check(name, unique, f"== {expected}", unique == expected)
    _measure_reach(poses, output)
    _check_stage(options, output)
    _compare_with_thesis(output)
    _tabulate_flexures(geometry, output)
    output.figure("figure_E-5", _figure(poses[:, :3]))


def _measure_reach(poses: FloatArray, output: Output) -> None:
    output.measure("reach/height", [float(poses[:, 2].min()), float(poses[:, 2].max())])
    output.measure("reach/aside", float(np.hypot(poses[:, 0], poses[:, 1]).max()))
    tilt = np.degrees(np.arccos(np.clip(poses[:, 11], -1.0, 1.0)))
    output.measure("reach/tilt_deg", float(tilt.max()))


def _check_stage(options: Options, output: Output) -> None:
    """Close the loops of random legs, and turn them by a third."""
    rng = np.random.default_rng(options.seed)
    count = QUICK_LENGTHS if options.quick else LENGTHS
    lengths = rng.uniform(1.0, 1.0 + options.extension, (count, 3))
    poses = stage_pose(lengths, 1.0)
    residual = float(np.abs(closure_residual(poses, lengths, 1.0)).max())
    output.measure("stage_residual", residual)
    output.check("stage residual in radii", residual, f"<= {EXACT:g}", residual <= EXACT)
    angle = 2.0 * np.pi / 3.0
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = stage_pose(np.roll(lengths, 1, axis=1), 1.0)
    position = np.abs(turned[:, :3] - poses[:, :3] @ turn.T).max()
    rotation = turn @ poses[:, 3:].reshape(-1, 3, 3) @ turn.T
    error = float(max(position, np.abs(turned[:, 3:] - rotation.reshape(-1, 9)).max()))
    output.measure("symmetry_error", error)
    output.check("three-fold symmetry of the stage", error, f"<= {EXACT:g}", error <= EXACT)


def _compare_with_thesis(output: Output) -> None:
    """Measure how far the repaired equations are off, in radii."""
    rows = []
    for extension in EXTENSIONS:
        lengths = state_lengths(StageGeometry(1.0, 1.0, 1.0 + extension))
        off = stage_pose(lengths, 1.0) - thesis_stage_pose(lengths, 1.0)
        place = np.linalg.norm(off[:, :3], axis=1)
        normal = np.linalg.norm(off[:, [5, 8, 11]], axis=1)
        mirrored = float(place[list(MIRRORED)].max())
        output.measure(f"thesis_stage_error/{extension:g}", float(place.max()))
        output.measure(f"thesis_stage_error/{extension:g}/mirrored", mirrored)
        rows.append([extension, mirrored, float(place.max()), float(normal.max())])
    columns = ("extension [r]", "legs 2 and 3 alike [r]", "any state [r]", "disc normal [rad]")
    output.table("thesis_stage", columns, rows)


def _tabulate_flexures(geometry: StageGeometry, output: Output) -> None:
    base, platform = joint_angles(geometry)
    output.measure("joint_angle_deg/base", float(np.degrees(base)))
    output.measure("joint_angle_deg/platform", float(np.degrees(platform)))
    rows = []
    for name, material in MATERIALS.items():
        thickness = greatest_thickness(STRIP_LENGTH, max(base, platform), material)
        torque = stiffness(STRIP_LENGTH, STRIP_WIDTH, thickness, material)
        # Torque that holds a leg at its greatest tilt, as a force across a leg of one disc radius.
        force = torque * max(base, platform) / DISC
        rows.append([name, material.bendability, 1e3 * thickness, force])
    columns = ("material", "M", "strip at most [mm]", "force to bend it [N]")
    output.table("flexures", columns, rows)


def _figure(places: FloatArray) -> Figure:
    """Draw the cloud in space, from the side and from above."""
    figure = Figure(figsize=(14, 4.8))
    sizes = figure.add_gridspec(1, 3, width_ratios=(1.2, 1.0, 1.0), wspace=0.35)
    cloud: Any = figure.add_subplot(sizes[0], projection="3d")
    cloud.scatter(places[:, 0], places[:, 1], places[:, 2], s=0.2, c=places[:, 2])
    cloud.set(xlabel="x [r]", ylabel="y [r]", title="tips of all words")
    cloud.set_box_aspect(np.ptp(places, axis=0))
    cloud.set_zlabel("z [r]", labelpad=2)
    cloud.locator_params(axis="z", nbins=3)
    for index, (across, up, title) in enumerate(((0, 2, "side"), (0, 1, "top"))):
        axes = figure.add_subplot(sizes[index + 1])
        axes.scatter(places[:, across], places[:, up], s=0.2, c=places[:, 2])
        axes.set(xlabel="xyz"[across] + " [r]", ylabel="xyz"[up] + " [r]", aspect="equal")
        axes.set_title(f"from the {title}")
        axes.grid(alpha=0.3)
    return figure
