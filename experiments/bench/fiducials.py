"""Our circles beside ArUco and AprilTag: same poses, same surface, same cameras, same spoiling.

Written down before any measured run:

- Poses: `POSES` of a scrambled Sobol sequence over `LOWEST` to `HIGHEST`, the faces turned about
  any axis across the line of sight, the motion blur in any direction. The place in the image is as
  free as keeps all markers in both images. A roll beyond `ROLL` is left out because two equal discs
  look the same upside down; a tag's roll would be known.
- Surface: each marker has the same square (`tags.SQUARE`).
- Images: integrated over 36 samples a pixel in 9 places, so that no method is limited by sampling
  (four samples, as elsewhere here, misplace a disc's rim and a tag's edge differently).
- Known before: the circles' detector gets the range to a fifth and the images' noise, OpenCV's
  detectors get neither; each stated deviation was calibrated on other poses, clean images.
- Scores: error of the middle between a body's markers, the angle of the rotation between estimate
  and truth, and the squared error of the twist by the stated covariance over 6. A body counts as
  detected if a pose is given, however wrong. Card and slot count singly.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import qmc

from experiments.bench.bench_options import Options
from experiments.bench.image_conditions import BLUR, CLEAN, CONDITIONS, Condition, take
from experiments.bench.tags import (
    FAMILIES,
    BodyPose,
    find_tags,
    fit_tags,
    numbers,
    paint_tags,
    single_image_pose,
)
from experiments.ch3.stereo.scene import HEAD
from experiments.ch5.marker_scene import (
    DISCS,
    TABLE_HEIGHT,
    MarkerScene,
    expectation,
    marker_cads,
    normal_prior,
)
from experiments.harness.figure_style import BLUE, GREEN, ORANGE, SKY
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.timing import compare
from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.blobs import detect_blobs
from perception.markers.bodies import match_bodies, triangulate
from perception.markers.poses import BodyPrior

POSES, QUICK_POSES = 64, 1
"""Number of poses; powers of two, as a Sobol sequence is balanced."""
QUICK_CONDITIONS = (CLEAN, BLUR)
LOWEST = {"range": 0.35, "slant": 0.0, "axis": 0.0, "roll": -30.0, "u": -1.0, "v": -1.0, "blur": 0}
HIGHEST = {"range": 1.1, "slant": 60.0, "axis": 360.0, "roll": 30.0, "u": 1.0, "v": 1.0,
           "blur": 180.0}  # fmt: skip
"""Range of the middle of the markers from midway between the cameras [m]; slant of the faces to the
line of sight, axis of the slant, roll and direction of the blur [deg]; place in the image."""
OVERSAMPLING = 3
CLEARANCE = 0.09
"""Largest distance of a tag's corner from the middle of all markers [m]."""
GAP = (0.0, -0.0175, 0.0)
"""Place of the card in the slot's frame [m]: before the mouth, parallel to it."""
SAMPLING = 0.04
"""What `MarkerExpectation.sampling` is for these images: with it the poses' NEES was 0.91."""
TIMED = 12
"""Number of clean pairs on which the methods are timed."""
OURS, OURS_TILT = "ours", "ours_tilt_known"
"""Blobs with an ellipse, as the insertion uses them: without, and with its prior of the tilt."""
METHODS = (OURS, *FAMILIES)


class SweptPose(NamedTuple):
    """One pose of the sweep.

    Attributes:
        distance: Range of the middle of the markers [m].
        slot: Transform from the slot to the left camera.
        direction: Direction of the motion blur [rad].
    """

    distance: float
    slot: RigidTransform
    direction: float


class Score(NamedTuple):
    """What one method gave for one body in one pair.

    Attributes:
        method: Name of the method.
        condition: Name of the condition.
        distance: Range [m].
        slant: Angle of the faces with the line of sight [deg].
        error_mm: Error of the middle between the markers [mm]; NaN if the body was not found.
        error_deg: Angle between the true and the estimated rotation [deg]; NaN likewise.
        nees: Squared error by the stated covariance over 6; NaN without one.
    """

    method: str
    condition: str
    distance: float
    slant: float
    error_mm: float
    error_deg: float
    nees: float


def sweep_poses(count: int, seed: int) -> list[SweptPose]:
    """Return poses of the slot before the cameras.

    Args:
        count: Number of poses.
        seed: Seed of the sequence's scrambling.
    """
    sequence = qmc.Sobol(len(LOWEST), rng=np.random.default_rng(seed))
    low, high = list(LOWEST.values()), list(HIGHEST.values())
    return [_swept(*row) for row in qmc.scale(sequence.random(count), low, high).tolist()]


def _swept(
    distance: float, slant: float, axis: float, roll: float, u: float, v: float, blur: float
) -> SweptPose:
    """Return a pose; arguments as in `LOWEST`."""
    # The markers are within a ball; both images show it if its outline is within their edges.
    wide, high = HEAD.width / (2.0 * HEAD.fx), HEAD.height / (2.0 * HEAD.fy)
    nearest = distance / math.hypot(1.0, wide, high)  # its depth in a corner of the image
    reach = math.asin(CLEARANCE / nearest)
    shift = HEAD.baseline / (2.0 * nearest)
    across = u * max(math.tan(math.atan(wide) - reach) - shift, 0.0)
    down = v * max(math.tan(math.atan(high) - reach), 0.0)
    sight = np.array([across, down, 1.0]) / math.hypot(across, down, 1.0)
    aim = Rotation.align_vectors([sight], [[0.0, 0.0, 1.0]])[0]
    tilt = math.radians(slant) * np.array(
        [math.cos(math.radians(axis)), math.sin(math.radians(axis)), 0.0]
    )
    facing = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    turn = (
        aim
        * Rotation.from_rotvec([0.0, 0.0, math.radians(roll)])
        * Rotation.from_rotvec(tilt)
        * facing
    )
    place = distance * sight + [HEAD.baseline / 2.0, 0.0, 0.0]
    slot = RigidTransform.from_components(place, turn)
    return SweptPose(
        distance, slot * RigidTransform.from_translation(-_middle()), math.radians(blur)
    )


@functools.cache
def _middle() -> FloatArray:
    """Return the middle of all markers, slot's frame [m]."""
    card, slot = marker_cads(CARD_AND_SLOT.slot_widths[1])
    return np.concatenate([card.points + GAP, slot.points]).mean(axis=0)


class FiducialScene:
    """Card and slot with each method's markers, and what each method makes of their images.

    Args:
        seed: Seed of the ground.

    Attributes:
        corners: Corners (4, 3) [m] in the body's frame by the tags' numbers, for each family those
            of the card's and of the slot's tags.
    """

    def __init__(self, seed: int) -> None:
        cads = marker_cads(CARD_AND_SLOT.slot_widths[1])
        self._scene = MarkerScene(
            np.random.default_rng(seed), None, functools.partial(paint_tags, cads=cads)
        )
        self._cads = cads
        self.corners = {
            name: [
                {
                    number: family.corners(centre)
                    for number, centre in zip(numbers(body, cad), cad.points, strict=True)
                }
                for body, cad in enumerate(cads)
            ]
            for name, family in FAMILIES.items()
        }

    def place(self, pose: SweptPose) -> None:
        """Place the bodies before the cameras."""
        slot = RigidTransform.from_translation([0.0, 0.0, TABLE_HEIGHT])
        card = slot * RigidTransform.from_translation(GAP)
        self._scene.place(slot, card, slot * pose.slot.inv())

    def exact_pairs(self, pose: SweptPose) -> dict[str, FloatArray]:
        """Place the bodies, and return (2, H, W) grey levels without noise for each method."""
        self.place(pose)
        pairs = {}
        for method, paint in zip(METHODS, (DISCS, *FAMILIES), strict=True):
            self._scene.wear(paint)
            pairs[method] = self._scene.exact_pair(OVERSAMPLING)
        return pairs

    def truth(self) -> tuple[RigidTransform, RigidTransform]:
        """Return the true transforms from card and slot to the left camera."""
        return self._scene.bodies()

    def circle_poses(
        self,
        pair: ImageArray,
        distance: float,
        condition: Condition,
        known: Sequence[Sequence[BodyPrior] | None] = (None,),
    ) -> list[list[BodyPose | None]]:
        """Return the poses of card and slot by their discs, one list for each set of priors.

        Args:
            pair: (2, H, W) uint8.
            distance: Range [m], which is known to a fifth.
            condition: Condition of the images, whose noise is known.
            known: Sets of priors of the poses of card and slot.
        """
        expected = dataclasses.replace(
            expectation(distance), noise=condition.noise, sampling=SAMPLING
        )
        left, right = (detect_blobs(image, HEAD, expected) for image in pair)
        pairs = triangulate(left, right, HEAD, expected)
        return [
            [
                None if fit is None else BodyPose(fit.transform_body_to_camera, fit.covariance)
                for fit in match_bodies(pairs, HEAD, self._cads, expected, priors)
            ]
            for priors in known
        ]

    def tag_poses(
        self, name: str, pair: ImageArray
    ) -> tuple[list[BodyPose | None], list[RigidTransform | None]]:
        """Return the poses of card and slot by their tags: from the pair, and by one tag each.

        Args:
            name: Name of the tags' family.
            pair: (2, H, W) uint8; one tag is looked at in the left image alone.
        """
        family = FAMILIES[name]
        seen = [find_tags(image, family) for image in pair]
        known = self.corners[name]
        return (
            [fit_tags(seen, corners, HEAD, family.sigma) for corners in known],
            [single_image_pose(seen[0], corners, HEAD) for corners in known],
        )

    def score(
        self, key: tuple[str, str], body: int, distance: float, found: BodyPose | None
    ) -> Score:
        """Compare a pose with the truth.

        Args:
            key: Names of the method and of the condition.
            body: 0 for the card, 1 for the slot.
            distance: Range [m].
            found: Estimated pose, if there is one.
        """
        truth, middle = self.truth()[body], self._cads[body].points.mean(axis=0)
        sight = truth.apply(middle)
        normal = truth.rotation.apply([0.0, 0.0, -1.0])
        slant = math.degrees(math.acos(float(normal @ sight / np.linalg.norm(sight))))
        if found is None:
            return Score(*key, distance, slant, math.nan, math.nan, math.nan)
        off = found.transform_body_to_camera.apply(middle) - sight
        twist = (truth * found.transform_body_to_camera.inv()).as_exp_coords()
        turn = math.degrees(float(np.linalg.norm(twist[:3])))
        nees = float(twist @ np.linalg.solve(found.covariance, twist)) / 6.0
        return Score(*key, distance, slant, 1e3 * float(np.linalg.norm(off)), turn, nees)


def bench_fiducials(options: Options, output: Output) -> None:
    """Set our circles beside ArUco and AprilTag in a sweep of poses, under each condition.

    Args:
        options: ``quick`` takes fewer poses.
        output: Receives ``marker_pose_error_mm/*``, ``marker_pose_error_deg/*``,
            ``marker_detected_fraction/*``, ``marker_nees/*``, ``marker_time_ratio/*`` and, for
            bodies that both found, ``marker_error_ratio_mm/*`` and ``marker_error_ratio_deg/*``.
    """
    seed = options.job_seeds(1, 1)[0]
    scene = FiducialScene(seed)
    swept = sweep_poses(QUICK_POSES if options.quick else POSES, seed)
    scores: list[Score] = []
    ratios: dict[str, list[float]] = {name: [] for name in FAMILIES}
    conditions = QUICK_CONDITIONS if options.quick else CONDITIONS
    for number, pose in enumerate(swept):
        exact = scene.exact_pairs(pose)
        for condition in conditions:
            which = CONDITIONS.index(condition)
            pairs = {
                # The same noise in every method's images.
                method: take(
                    exact[method], condition, pose.direction,
                    np.random.default_rng((seed, number, which)),
                )
                for method in METHODS
            }  # fmt: skip
            priors = np.random.default_rng((seed, number, which, 1))
            scores += _scores(scene, pairs, pose.distance, condition, priors)
            if condition == CLEAN and number < TIMED:
                for name in FAMILIES:
                    ratios[name].append(_time_ratio(scene, name, pairs, pose.distance))
    _measure(scores, output)
    for name, values in ratios.items():
        output.measure(f"marker_time_ratio/{name}_over_ours", distribution(values))
    output.table("fiducials", Score._fields, scores)
    output.figure("fiducials", draw_errors(scores))


def _scores(
    scene: FiducialScene,
    pairs: dict[str, ImageArray],
    distance: float,
    condition: Condition,
    rng: np.random.Generator,
) -> list[Score]:
    """Return the scores of all methods for one pose under one condition."""
    priors = [normal_prior(body, rng) for body in scene.truth()]
    alone, tilt_known = scene.circle_poses(pairs[OURS], distance, condition, (None, priors))
    found = {OURS: alone, OURS_TILT: tilt_known}
    unstated = np.full((6, 6), np.nan)
    for name in FAMILIES:
        found[name], single = scene.tag_poses(name, pairs[name])
        if condition == CLEAN:
            found[f"{name}_one_image"] = [
                None if pose is None else BodyPose(pose, unstated) for pose in single
            ]
    return [
        scene.score((name, condition.name), body, distance, pose)
        for name, poses in found.items()
        for body, pose in enumerate(poses)
    ]


def _time_ratio(
    scene: FiducialScene, name: str, pairs: dict[str, ImageArray], distance: float
) -> float:
    """Return a family's time for a pair, images to poses, over ours."""
    theirs = functools.partial(scene.tag_poses, name, pairs[name])
    ours = functools.partial(scene.circle_poses, pairs[OURS], distance, CLEAN)
    return float(compare(theirs, ours, 1)["ratio"]["median"])


def _measure(scores: list[Score], output: Output) -> None:
    """Store each method's results under each condition, and under both exposures together."""
    cells: dict[tuple[str, str], list[Score]] = {}
    for score in scores:
        cells.setdefault((score.method, score.condition), []).append(score)
        if score.condition.startswith("exposure"):
            cells.setdefault((score.method, "exposure"), []).append(score)
    for (method, condition), cell in cells.items():
        key = f"{method}/{condition}"
        found = [score for score in cell if math.isfinite(score.error_mm)]
        output.measure(f"marker_detected_fraction/{key}", fraction(len(found), len(cell)))
        if found:
            output.measure(f"marker_pose_error_mm/{key}", distribution(s.error_mm for s in found))
            output.measure(f"marker_pose_error_deg/{key}", distribution(s.error_deg for s in found))
        if found and math.isfinite(found[0].nees):
            output.measure(f"marker_nees/{key}", distribution(s.nees for s in found))
        if method in FAMILIES:
            _measure_ratios(f"{method}_over_ours/{condition}", cell, cells[OURS, condition], output)


def _measure_ratios(key: str, theirs: list[Score], ours: list[Score], output: Output) -> None:
    """Store the errors over ours of the bodies that both found: farther ones are harder."""
    both = [
        (one, two)
        for one, two in zip(theirs, ours, strict=True)
        if math.isfinite(one.error_mm) and math.isfinite(two.error_mm)
    ]
    if both:
        millimetres = distribution(one.error_mm / two.error_mm for one, two in both)
        degrees = distribution(one.error_deg / two.error_deg for one, two in both)
        output.measure(f"marker_error_ratio_mm/{key}", millimetres)
        output.measure(f"marker_error_ratio_deg/{key}", degrees)


def draw_errors(scores: list[Score]) -> Figure:
    """Draw position and rotation errors over range, a column for each condition.

    Args:
        scores: Scores of all methods.
    """
    names = list(dict.fromkeys(score.condition for score in scores))
    figure = Figure(figsize=(3.0 * len(names), 6.5), layout="constrained")
    grid = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
    colours = dict(zip((*METHODS, OURS_TILT), (BLUE, ORANGE, GREEN, SKY)))
    edges = np.linspace(LOWEST["range"], HIGHEST["range"], 6)
    for column, condition in enumerate(names):
        for method, colour in colours.items():
            cell = [s for s in scores if (s.method, s.condition) == (method, condition)]
            if not cell:
                continue
            distances = np.array([score.distance for score in cell])
            found = np.mean([math.isfinite(score.error_mm) for score in cell])
            label = f"{method.replace('_', ' ')}: {found:.0%} found"
            for axes, name in zip(grid[:, column], ("error_mm", "error_deg"), strict=True):
                values = np.array([getattr(score, name) for score in cell])
                axes.plot(distances, values, ".", color=colour, markersize=3, alpha=0.5)
                # A line where at least half of the bodies were found.
                middles, medians = [], []
                for low, high in zip(edges[:-1], edges[1:]):
                    within = values[(distances >= low) & (distances < high)]
                    if 2 * np.isfinite(within).sum() >= len(within) > 0:
                        middles.append((low + high) / 2.0)
                        medians.append(np.nanmedian(within))
                axes.plot(middles, medians, "-", color=colour, linewidth=1.8, label=label)
        top, bottom = grid[:, column]
        top.set(title=condition.replace("_", ", "), yscale="log")
        bottom.set(xlabel="range [m]", yscale="log")
        top.set_xlim(LOWEST["range"], HIGHEST["range"])
        top.legend(fontsize=6, loc="lower right")
    grid[0, 0].set_ylabel("position error [mm]")
    grid[1, 0].set_ylabel("rotation error [deg]")
    return figure
