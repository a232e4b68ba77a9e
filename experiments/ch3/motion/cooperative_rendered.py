"""Cooperative stereo on rendered pairs: both rovers look at the panel and what stands about it.

The panel's markers, whose places on it are known, tell each robot where it is, and so the relative
pose. Points that the first robot's stereo found are then sought in the second one's left image:
their surroundings distorted as the surface about them, fitted to the first robot's own points, has
it. The truth puts the arms where the panel is in view, and scores.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.scores import joint_nees, rms, single_nees
from experiments.ch3.stereo.scene import CapturedPair, StereoScene
from experiments.ch3.stereo.trial import target_cad
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray
from perception.registration.cooperative import (
    RelativePose,
    SharedPoints,
    fuse_views,
    relative_pose_by_target,
    triangulate_together,
)
from perception.registration.motion import RegistrationError
from perception.registration.patch_matching import match_across, surface_normals
from perception.registration.reprojection import Sighting
from perception.registration.target import SeenTarget, find_target
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoMatcher

MARKER_SIGMA = (0.1, 0.1, 0.05)
"""Deviations of a marker's column, row and disparity [px]."""
PLACE_SIGMA = 0.01
"""Deviation of a point's column and row in the first view [px]: it is where it was chosen to be."""
POINTS = 200  # Sought across, at most
APART = 12.0  # Least distance of two of them [px]
DEPTH = (2,)
"""A point is what its pixel in the first view shows: it can be wrong along the ray alone."""
POSTURES = 1200  # Of an arm, drawn until the panel is in view
REACH = (0.6, 1.0, 1.0, 1.2)  # How far postures are drawn about the home posture [rad]
MARGIN = 25.0  # Of the panel's markers from the border [px]
GROSS = 0.02  # Errors beyond this are wrong matches [m].
CASES = ("single", "fused", "bundle", "target", "perfect")
WAYS = ("markers", "target", "bundle", "joint")
"""Of telling the relative pose: the markers as mere points, as those of a known target, the points
alone, and the points and the target together."""


@dataclasses.dataclass(frozen=True)
class RenderedErrors:
    """Errors over the rendered scenes.

    Attributes:
        errors: (runs,) r.m.s. errors of points [mm] by case.
        nees: (runs,) squared errors over their covariance, per degree of freedom, by case.
        images: (2, H, W) left images of both robots, of one scene.
        matches: (N, 4) column and row in the first and in the second [px].
    """

    errors: dict[str, FloatArray]
    nees: dict[str, FloatArray]
    images: NDArray[np.uint8]
    matches: FloatArray


@dataclasses.dataclass
class RenderedPair:
    """One rendered scene, triangulated in every way that succeeds.

    Attributes:
        errors: R.m.s. error of the points in the first camera by case [mm]; infinite where it
            failed.
        nees: Squared error over its covariance per degree of freedom by case; NaN where it failed.
        pose_errors: (2,) error of the relative pose by `WAYS` [mm, deg]; infinite where it failed.
        baseline_m: Distance between the two left cameras [m].
        images: (2, H, W) uint8 left images of both robots.
        marker_errors: (k, 3) errors of the markers' columns, rows and disparities [px].
        matches: (N, 4) column and row in the first and in the second [px].
        sought: Number of points sought in the second view.
        matched: Number of points found there.
        range_m: Median distance of the points [m]; infinite without any.
        agreed: (N,) whether triangulation kept each point, 0 or 1.
        gross: (N,) whether a point that was kept is grossly wrong, 0 or 1.
    """

    errors: dict[str, float]
    nees: dict[str, float]
    pose_errors: dict[str, FloatArray]
    baseline_m: float
    images: NDArray[np.uint8]
    marker_errors: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    matches: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    sought: int = 0
    matched: int = 0
    range_m: float = np.inf
    agreed: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    gross: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))


@dataclasses.dataclass(frozen=True)
class _Shared:
    """Points found in both views: as the first robot sees them and as the second."""

    first: Sighting
    second: Sighting
    sought: int


def measure_rendered(options: contract.Options, output: Output) -> RenderedErrors:
    """Triangulate rendered scenes over seeds.

    Args:
        options: ``quick`` takes 1 scene instead of 8.
        output: Receives what matching and the target are worth; errors are returned.
    """
    results = sweep(
        triangulate_rendered, options.job_seeds(8, 1), options, output, label="cooperative scenes"
    )
    found = sum(r.matched for r in results)
    sought = sum(r.sought for r in results)
    output.measure("cooperative_matched_fraction", fraction(found, max(sought, 1)))
    agreed = np.concatenate([r.agreed for r in results])
    gross = np.concatenate([r.gross for r in results])
    if len(agreed):
        output.measure(
            "cooperative_rejected_fraction", fraction(int((~(agreed > 0.5)).sum()), len(agreed))
        )
        wrong = int(np.sum((agreed > 0.5) & (gross > 0.5)))
        output.measure("cooperative_wrong_kept_fraction", fraction(wrong, len(agreed)))
    for key in ("range_m", "baseline_m"):
        output.measure(f"cooperative_{key}", distribution([getattr(r, key) for r in results]))
    for way in WAYS:
        for part, name in enumerate(("mm", "deg")):
            values = [float(r.pose_errors[way][part]) for r in results]
            output.measure(f"cooperative_pose_error_{name}/{way}", distribution(values))
    markers = np.concatenate([r.marker_errors for r in results])
    for axis, values in zip(("column", "row", "disparity"), markers.T, strict=True):
        if len(values):
            output.measure(
                f"cooperative_marker_error_px/{axis}", float(np.sqrt(np.mean(values**2)))
            )
    shown = results[0]
    return RenderedErrors(
        {case: np.array([r.errors[case] for r in results]) for case in CASES},
        {case: np.array([r.nees[case] for r in results]) for case in CASES[1:]},
        shown.images,
        shown.matches,
    )


def triangulate_rendered(seed: int) -> RenderedPair:
    """Render both robots' views of a scene and triangulate in every way; a job of the sweep."""
    scene = StereoScene(seed)
    rng = np.random.default_rng(np.random.SeedSequence((seed, 62)))
    for name in scene.robot_names:
        face_panel(scene, name, rng)
    views = [scene.capture(name) for name in scene.robot_names]
    result = _nothing(views)
    cad = target_cad(scene)
    found = [find_target(view.pair, scene.geometry, cad, MARKER_SIGMA) for view in views]
    if found[0] is None or found[1] is None:
        return result
    seen = (found[0], found[1])
    result.marker_errors = _marker_errors(scene, views, seen)
    truth = views[0].transform_camera_to_world.inv() * views[1].transform_camera_to_world
    by_markers = _by_markers(seen, scene.geometry)
    result.pose_errors["markers"] = _pose_error(by_markers, truth)
    by_target = _by_target(seen, cad.points, scene.geometry)
    result.pose_errors["target"] = _pose_error(by_target, truth)
    if by_target is None:
        return result
    shared = _match(views, by_target, scene.geometry)
    result.sought, result.matched = shared.sought, len(shared.first.image_points)
    pixels = shared.first.image_points[:, :2]
    result.matches = np.column_stack([pixels, shared.second.image_points[:, :2]])
    if len(pixels):
        depths = scene.true_depths(scene.robot_names[0], pixels)
        disparities = scene.geometry.fx * scene.geometry.baseline / depths
        true = scene.geometry.points(np.column_stack([pixels, disparities]))
        _triangulate(result, shared, true, truth, by_target)
    return result


def face_panel(scene: StereoScene, name: str, rng: np.random.Generator) -> None:
    """Put an arm where the panel's markers are in view, near the middle and 1.1 m away if it can.

    Args:
        scene: Its arm is moved.
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
        inside = (seen[:, 0] - seen[:, 2] > MARGIN) & (seen[:, 0] < g.width - MARGIN)
        inside &= (seen[:, 1] > MARGIN) & (seen[:, 1] < g.height - MARGIN)
        if not inside.all() or scene.arm_touches(name):
            continue
        middle = g.project(pose.apply(panel.translation, inverse=True))[:2]
        away = float(np.linalg.norm(pose.translation - panel.translation))
        score = float(np.hypot(*(middle - [g.cx, g.cy]))) / 100.0 + abs(away - 1.1) / 0.1
        if best is None or score < best[0]:
            best = (score, angles)
    if best is None:
        raise RuntimeError(f"no posture of {name} shows the panel in scene {scene.seed}")
    scene.set_joints(name, best[1])


def _nothing(views: Sequence[CapturedPair]) -> RenderedPair:
    """Return the result of a scene in which nothing succeeds."""
    places = [view.transform_camera_to_world.translation for view in views]
    return RenderedPair(
        dict.fromkeys(CASES, np.inf),
        dict.fromkeys(CASES, np.nan),
        {way: np.full(2, np.inf) for way in WAYS},
        float(np.linalg.norm(places[1] - places[0])),
        np.stack([view.pair[0] for view in views]),
    )


def _marker_errors(
    scene: StereoScene, views: Sequence[CapturedPair], seen: Sequence[SeenTarget]
) -> FloatArray:
    """Hold markers (N, 3) [px] against where the faces of their dark discs truly are."""
    errors: list[FloatArray] = []
    for view, target in zip(views, seen, strict=True):
        places = scene.panel.marker_points[target.indices]
        world = scene.transform_panel_to_world.apply(places)
        local = view.transform_camera_to_world.apply(world, inverse=True)
        errors.append(target.image_points - scene.geometry.project(local))
    return np.concatenate(errors)


def _by_markers(seen: Sequence[SeenTarget], geometry: StereoGeometry) -> RelativePose | None:
    """Return the relative pose by the markers as points of which nothing is known."""
    both = np.intersect1d(seen[0].indices, seen[1].indices)
    first, second = (
        _sighting(target, geometry).chosen(np.isin(target.indices, both)) for target in seen
    )
    try:
        return triangulate_together(first, second).relative
    except RegistrationError:
        return None


def _by_target(
    seen: Sequence[SeenTarget], markers: FloatArray, geometry: StereoGeometry
) -> RelativePose | None:
    """Return the relative pose by the target's CAD."""
    one, two = (_sighting(target, geometry) for target in seen)
    try:
        return relative_pose_by_target(one, markers[seen[0].indices], two, markers[seen[1].indices])
    except RegistrationError:
        return None


def _sighting(target: SeenTarget, geometry: StereoGeometry) -> Sighting:
    sigma = np.tile(MARKER_SIGMA, (len(target.indices), 1))
    return Sighting(target.image_points, sigma, geometry)


def _match(
    views: Sequence[CapturedPair], relative: RelativePose, geometry: StereoGeometry
) -> _Shared:
    """Find points of the first robot's stereo in the second's view."""
    cloud = StereoMatcher(geometry).match(views[0].pair)
    second = relative.transform_second_to_first
    there = geometry.project(second.apply(cloud.points, inverse=True))
    inside = (there[:, 0] - there[:, 2] > MARGIN) & (there[:, 0] < geometry.width - MARGIN)
    inside &= (there[:, 1] > MARGIN) & (there[:, 1] < geometry.height - MARGIN)
    chosen = _spaced(cloud.pixels, np.flatnonzero(inside))
    seen = np.column_stack([cloud.pixels[chosen], cloud.disparities[chosen]])
    normals = surface_normals(cloud.points[chosen], cloud.points)
    across = match_across(views[0].pair, views[1].pair, seen, normals, geometry, second)
    found = across.found
    sigma = np.full((len(chosen), 3), PLACE_SIGMA)
    sigma[:, 2] = cloud.sigmas[chosen]
    return _Shared(
        Sighting(seen[found], sigma[found], geometry),
        Sighting(across.image_points[found], across.sigma[found], geometry),
        len(chosen),
    )


def _spaced(pixels: FloatArray, candidates: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return some candidates, no two of them near one another: one for each cell of a grid."""
    edge = APART
    cells = np.floor(pixels[candidates] / edge).astype(int)
    _, first = np.unique(cells, axis=0, return_index=True)
    step = max(1, -(-len(first) // POINTS))
    return candidates[np.sort(first)[::step]]


def _triangulate(
    result: RenderedPair,
    shared: _Shared,
    true: FloatArray,
    truth: RigidTransform,
    by_target: RelativePose,
) -> None:
    """Enter what each case makes of the matched points."""
    first, second = shared.first, shared.second
    result.range_m = float(np.median(true[:, 2]))
    found: dict[str, SharedPoints] = {}
    priors = {
        "bundle": None,
        "target": by_target,
        "perfect": RelativePose(truth, np.zeros((6, 6))),
    }
    for case, prior in priors.items():
        try:
            found[case] = triangulate_together(first, second, prior)
        except RegistrationError:
            continue
        result.errors[case] = rms(found[case].points - true[found[case].inliers])
        result.nees[case] = joint_nees(found[case], true, DEPTH)
    for way, case in (("bundle", "bundle"), ("joint", "target")):
        if case in found:
            result.pose_errors[way] = _pose_error(found[case].relative, truth)
    if "target" not in found:
        return
    kept = found["target"].inliers
    alone = first.geometry.points(first.image_points)
    other = second.geometry.points(second.image_points)
    fused = fuse_views(
        alone[kept],
        first.geometry.covariance(alone, first.sigma)[kept],
        other[kept],
        second.geometry.covariance(other, second.sigma)[kept],
        by_target,
    )
    result.errors["single"] = rms(alone[kept] - true[kept])
    result.errors["fused"] = rms(fused.points - true[kept])
    result.nees["fused"] = single_nees(fused.points - true[kept], fused.covariances, DEPTH)
    gross = np.zeros(len(kept))
    gross[kept] = np.linalg.norm(found["target"].points - true[kept], axis=1) > GROSS
    result.agreed, result.gross = kept.astype(float), gross


def _pose_error(estimate: RelativePose | None, truth: RigidTransform) -> FloatArray:
    """Return how far off a relative pose is, [mm, deg]; infinite if there is none."""
    if estimate is None:
        return np.full(2, np.inf)
    off = truth * estimate.transform_second_to_first.inv()
    apart = estimate.transform_second_to_first.translation - truth.translation
    return np.array([1000.0 * float(np.linalg.norm(apart)), np.degrees(off.rotation.magnitude())])
