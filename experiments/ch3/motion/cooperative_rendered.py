"""Cooperative stereo on rendered pairs: both rovers view the panel and its surroundings.

The panel's markers, whose positions on it are known, give each robot's pose, and so the relative
pose. Points of the first robot's stereo are then searched for in the second one's left image: their
surroundings are warped by the surface fitted to the first robot's own points about them. The truth
puts the arms where the panel is in view, and scores.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.motion import in_both_images
from experiments.ch3.motion.scores import Triangulated, found_or_none, fuse_sightings, rms
from experiments.ch3.stereo.scene import CapturedPair, StereoScene
from experiments.ch3.stereo.trial import target_cad
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import BoolArray, FloatArray
from perception.registration.cooperative import (
    RelativePose,
    SharedPoints,
    relative_pose_by_target,
    triangulate_together,
)
from perception.registration.patch_matching import match_across, surface_normals
from perception.registration.reprojection import Sighting
from perception.registration.target import SeenTarget, find_target
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoMatcher

MARKER_SIGMA = (0.1, 0.1, 0.05)
"""Standard deviations of a marker's column, row and disparity [px]."""
PLACE_SIGMA = 0.01
"""Standard deviation of a point's column and row in the first view [px]: it is where it was chosen
to be."""
POINTS = 200  # Greatest number of points searched for in the second view
APART = 12.0  # Edge of the cells that hold one point each [px]
DEPTH = (2,)
"""A point is what its pixel in the first view shows: it can be wrong along the ray alone."""
POSTURES = 1200  # Postures of an arm that are drawn
REACH = (0.6, 1.0, 1.0, 1.2)  # Greatest distance of a posture from the home posture [rad]
MARGIN = 25.0  # Distance of the panel's markers from the border [px]
GROSS = 0.02  # Errors beyond this are wrong matches [m].
CASES = ("single", "fused", "bundle", "target", "perfect")
ESTIMATES = ("markers", "target", "bundle", "joint")
"""Estimates of the relative pose: by the markers as mere points, by the markers of a known target,
by the points alone, and by the points and the target together."""


@dataclasses.dataclass
class RenderedPair(Triangulated):
    """One rendered scene, triangulated in every way that succeeds.

    Attributes:
        pose_errors: (2,) error of the relative pose by `ESTIMATES` [mm, deg]; infinite where it
            failed.
        baseline_m: Distance between the two left cameras [m].
        images: (2, H, W) uint8 left images of both robots.
        marker_errors: (k, 3) errors of the markers' columns, rows and disparities [px].
        matches: (N, 4) column and row in the first and in the second image [px].
        sought: Number of points searched for in the second view.
        range_m: Median distance of the points [m]; infinite without any.
        agreed: (N,) whether triangulation kept each point.
        gross: (N,) whether a point that was kept is grossly wrong.
    """

    pose_errors: dict[str, FloatArray]
    baseline_m: float
    images: NDArray[np.uint8]
    marker_errors: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    matches: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    sought: int = 0
    range_m: float = np.inf
    agreed: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(0, np.bool_))
    gross: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(0, np.bool_))


def measure_rendered(options: contract.RepeatedOptions, output: Output) -> list[RenderedPair]:
    """Triangulate rendered scenes over seeds.

    Args:
        options: ``quick`` takes 1 scene instead of 8.
        output: Receives the results of matching and of the target; the errors of points are
            returned.
    """
    seeds = options.job_seeds(8, 1)
    results = sweep(triangulate_rendered, seeds, options, output, label="cooperative scenes")
    found, sought = sum(len(r.matches) for r in results), sum(r.sought for r in results)
    output.measure("cooperative_matched_fraction", fraction(found, max(sought, 1)))
    agreed = np.concatenate([r.agreed for r in results])
    if len(agreed):
        rejected = int(np.sum(~agreed))
        output.measure("cooperative_rejected_fraction", fraction(rejected, len(agreed)))
        wrong = int(np.sum(agreed & np.concatenate([r.gross for r in results])))
        output.measure("cooperative_wrong_kept_fraction", fraction(wrong, len(agreed)))
    output.measure("cooperative_range_m", distribution([r.range_m for r in results]))
    output.measure("cooperative_baseline_m", distribution([r.baseline_m for r in results]))
    for estimate in ESTIMATES:
        for part, name in enumerate(("mm", "deg")):
            values = [r.pose_errors[estimate][part] for r in results]
            output.measure(f"cooperative_pose_error_{name}/{estimate}", distribution(values))
    markers = np.concatenate([r.marker_errors for r in results])
    if len(markers):
        for axis, values in zip(("column", "row", "disparity"), markers.T, strict=True):
            error = float(np.sqrt(np.mean(values**2)))
            output.measure(f"cooperative_marker_error_px/{axis}", error)
    return results


def triangulate_rendered(seed: int) -> RenderedPair:
    """Render both robots' views of a scene and triangulate in every way; a job of the sweep."""
    scene = StereoScene(seed)
    rng = np.random.default_rng(np.random.SeedSequence((seed, 62)))
    for name in scene.robot_names:
        face_panel(scene, name, rng)
    views = [scene.capture(name) for name in scene.robot_names]
    first, second = (view.transform_camera_to_world for view in views)
    truth = first.inv() * second
    result = RenderedPair(
        errors=dict.fromkeys(CASES, np.inf),
        nees=dict.fromkeys(CASES, np.nan),
        pose_errors={estimate: np.full(2, np.inf) for estimate in ESTIMATES},
        baseline_m=float(np.linalg.norm(second.translation - first.translation)),
        images=np.stack([view.pair[0] for view in views]),
    )
    cad = target_cad(scene)
    targets = [find_target(view.pair, scene.geometry, cad, MARKER_SIGMA) for view in views]
    seen = [target for target in targets if target is not None]
    if len(seen) < len(views):
        return result
    result.marker_errors = _marker_errors(scene, views, seen)
    one, other = (_sighting(target, scene.geometry) for target in seen)
    markers = [cad.points[target.indices] for target in seen]
    both = np.intersect1d(seen[0].indices, seen[1].indices)
    by_markers = found_or_none(
        triangulate_together,
        one.chosen(np.isin(seen[0].indices, both)),
        other.chosen(np.isin(seen[1].indices, both)),
    )
    if by_markers is not None:
        result.pose_errors["markers"] = _pose_error(by_markers.relative, truth)
    by_target = found_or_none(relative_pose_by_target, one, markers[0], other, markers[1])
    if by_target is None:
        return result
    result.pose_errors["target"] = _pose_error(by_target, truth)
    one, other, result.sought = _match(views, by_target, scene.geometry)
    pixels = one.image_points[:, :2]
    result.matches = np.column_stack([pixels, other.image_points[:, :2]])
    if len(pixels):
        true = scene.true_points(scene.robot_names[0], pixels)
        _triangulate(result, one, other, true, by_target, truth)
    return result


def face_panel(scene: StereoScene, name: str, rng: np.random.Generator) -> None:
    """Move an arm until the panel's markers are in view, near the middle and 1.1 m away if it can.

    Args:
        scene: Scene whose arm is moved.
        name: Name of the robot.
        rng: Random generator for the postures.

    Raises:
        RuntimeError: If no posture shows the markers.
    """
    g, panel = scene.geometry, scene.transform_panel_to_world
    markers = panel.apply(scene.panel.marker_points)
    home, limits = scene.joints(name), scene.joint_limits(name).T
    best: tuple[float, FloatArray] | None = None
    for _ in range(POSTURES):
        angles = np.clip(home + rng.uniform(-1.0, 1.0, 4) * REACH, *limits)
        scene.set_joints(name, angles)
        pose = scene.transform_camera_to_world(name)
        seen = g.project(pose.apply(markers, inverse=True))
        if not in_both_images(g, seen, MARGIN).all() or scene.arm_touches(name):
            continue
        middle = g.project(pose.apply(panel.translation, inverse=True))[:2]
        away = float(np.linalg.norm(pose.translation - panel.translation))
        score = float(np.hypot(*(middle - [g.cx, g.cy]))) / 100.0 + abs(away - 1.1) / 0.1
        if best is None or score < best[0]:
            best = (score, angles)
    if best is None:
        raise RuntimeError(f"no posture of {name} shows the panel in scene {scene.seed}")
    scene.set_joints(name, best[1])


def _marker_errors(
    scene: StereoScene, views: Sequence[CapturedPair], seen: Sequence[SeenTarget]
) -> FloatArray:
    """Return the errors (N, 3) [px] of the markers against the true faces of their dark discs."""
    errors: list[FloatArray] = []
    for view, target in zip(views, seen, strict=True):
        places = scene.panel.marker_points[target.indices]
        world = scene.transform_panel_to_world.apply(places)
        local = view.transform_camera_to_world.apply(world, inverse=True)
        errors.append(target.image_points - scene.geometry.project(local))
    return np.concatenate(errors)


def _sighting(target: SeenTarget, geometry: StereoGeometry) -> Sighting:
    sigma = np.tile(MARKER_SIGMA, (len(target.indices), 1))
    return Sighting(target.image_points, sigma, geometry)


def _match(
    views: Sequence[CapturedPair], relative: RelativePose, geometry: StereoGeometry
) -> tuple[Sighting, Sighting, int]:
    """Find points of the first robot's stereo in the second's view; also how many were sought."""
    cloud = StereoMatcher(geometry).match(views[0].pair)
    second = relative.transform_second_to_first
    there = geometry.project(second.apply(cloud.points, inverse=True))
    inside = np.flatnonzero(in_both_images(geometry, there, MARGIN))
    # One point for each cell of a grid, so that no two are near one another.
    cells = np.floor(cloud.pixels[inside] / APART).astype(int)
    spaced = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    chosen = inside[spaced[:: max(1, -(-len(spaced) // POINTS))]]
    seen = np.column_stack([cloud.pixels[chosen], cloud.disparities[chosen]])
    normals = surface_normals(cloud.points[chosen], cloud.points)
    across = match_across(views[0].pair, views[1].pair, seen, normals, geometry, second)
    sigma = np.column_stack([np.full((len(chosen), 2), PLACE_SIGMA), cloud.sigmas[chosen]])
    first = Sighting(seen, sigma, geometry).chosen(across.found)
    other = Sighting(across.image_points, across.sigma, geometry).chosen(across.found)
    return first, other, len(chosen)


def _triangulate(
    result: RenderedPair,
    first: Sighting,
    second: Sighting,
    true: FloatArray,
    by_target: RelativePose,
    truth: RigidTransform,
) -> None:
    """Triangulate the matched points in each way and score them."""
    result.range_m = float(np.median(true[:, 2]))
    found: dict[str, SharedPoints] = {}
    exact = RelativePose(truth, np.zeros((6, 6)))
    for case, prior in (("bundle", None), ("target", by_target), ("perfect", exact)):
        shared = found_or_none(triangulate_together, first, second, prior)
        if shared is not None:
            found[case] = shared
            result.score_shared(case, shared, true, DEPTH)
    for estimate, case in (("bundle", "bundle"), ("joint", "target")):
        if case in found:
            result.pose_errors[estimate] = _pose_error(found[case].relative, truth)
    if "target" not in found:
        return
    result.agreed = kept = found["target"].inliers
    first, second, true = first.chosen(kept), second.chosen(kept), true[kept]
    result.errors["single"] = rms(first.geometry.points(first.image_points) - true)
    result.score_fused("fused", fuse_sightings(first, second, by_target), true, DEPTH)
    result.gross = np.zeros(len(kept), np.bool_)
    result.gross[kept] = np.linalg.norm(found["target"].points - true, axis=1) > GROSS


def _pose_error(estimate: RelativePose, truth: RigidTransform) -> FloatArray:
    """Return the error of a relative pose [mm, deg]."""
    off = truth * estimate.transform_second_to_first.inv()
    apart = estimate.transform_second_to_first.translation - truth.translation
    return np.array([1000.0 * float(np.linalg.norm(apart)), np.degrees(off.rotation.magnitude())])
