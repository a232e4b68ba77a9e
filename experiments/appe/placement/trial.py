"""A camera is placed (chapter 4), BRAID is driven there, and what is seen is rendered."""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.braid.arm.chain import all_words, forward
from controllers.braid.arm.inverse import BinaryArm, InverseConfig, solve
from controllers.braid.arm.obstacles import LinkCheck
from controllers.braid.arm.stage import STATES
from controllers.braid.bus.drive import WireDrive, word_bits
from controllers.placement.spatial.occluders import TargetField, expand
from controllers.placement.spatial.search import (
    SearchConfig,
    SpatialTask,
    rate_positions,
    views_in_order,
)
from controllers.placement.task import PlacementError, View
from experiments.appe.mechanism.bench import GEOMETRY
from experiments.appe.placement.scene import (
    FACING,
    TARGET_RADIUS,
    RoverView,
    draw_setting,
)
from experiments.ch3.stereo.scene import look_at
from experiments.ch4.spatial.blocks import (
    CLEARANCE,
    believed_blocks,
    margins_of,
    occluders_of,
    occupancy_of,
)
from experiments.ch4.spatial.placement_scene import head_lens
from experiments.ch4.spatial.search import disc
from models.blocks import Block
from perception.geometry.arrays import FloatArray, IntArray

WEIGHT = 0.1
"""Distance [m] that costs as much as a radian of the camera's direction: half its field of view is
then 36 mm."""
NEAR_A_WORD = 0.015
"""Greatest distance of a placement that is tried from a word that views the target [m]."""
ROLLS = np.deg2rad([0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0])
MARGIN = 40.0
"""Least distance of the target from the picture's edge, by the kinematics [px]."""
TRIES = 400
RANDOM_WORDS = 5
REST = 0.5
SEARCH = SearchConfig(level=5, rings=24, refine=False)


@dataclasses.dataclass(frozen=True)
class PlacementTrial:
    """One setting.

    Attributes:
        seed: Seed of the scene and of the search.
        stages: Number of BRAID's stages, up to 5: their words are all listed.
    """

    seed: int
    stages: int


@dataclasses.dataclass(frozen=True)
class Plan:
    """A word that brings the camera before the target.

    Attributes:
        view: The placement that the word realises.
        word: (n,) states.
        transform_camera_to_world: Pose of the camera by the kinematics.
        tries: Number of placements that were tried, this one included.
    """

    view: View
    word: IntArray
    transform_camera_to_world: RigidTransform
    tries: int


class BraidPlanner:
    """Finds placements that BRAID can take, from blocks that are believed to be so.

    Attributes:
        lens: Field of view and range of the left camera.
        field: The target with what may hide it.
        seeing: Number of words that see the target, by the kinematics.
    """

    def __init__(self, scene: RoverView, target: FloatArray, believed: tuple[Block, ...]) -> None:
        """Expand the blocks and list where the camera can be.

        Args:
            scene: Scene that gives the rover's pose and the camera's mount, which a rover knows.
            target: (3,) target [m], world.
            believed: Blocks as they are believed to be.

        Raises:
            PlacementError: If a block hides the target from everywhere.
        """
        margins = margins_of(believed)
        self.lens = head_lens()
        goal = disc("target", TARGET_RADIUS, target, FACING)
        self.field: TargetField = expand(goal, occluders_of(believed), margins)
        self._base, self._mount = scene.transform_base_to_world, scene.transform_camera_to_tip
        self._intrinsics = scene.intrinsics
        self._arm = BinaryArm(scene.bench.stages, GEOMETRY, InverseConfig(weight=WEIGHT))
        self._blocked = occupancy_of(believed, margins)
        self._links = LinkCheck(GEOMETRY, _in_base(believed, margins, self._base))
        places = self._viewing_positions(target)
        seeing = rate_positions(self.field, self.lens, places, self._blocked) if len(places) else []
        self.seeing = sum(view.rating > 0.0 for view in seeing)
        # Without any word that looks at the target, every place is far.
        self._reach = cKDTree(places if len(places) else np.full((1, 3), 1e3))

    def _viewing_positions(self, target: FloatArray) -> FloatArray:
        """Return the camera's positions (N, 3) [m], world, in clear words that view the target."""
        words = all_words(self._arm.count)
        tips = forward(self._arm.stages, words)
        turns = tips[:, 3:].reshape(-1, 3, 3)
        aim = np.einsum("nji,nj->ni", turns, self._base.inv().apply(target) - tips[:, :3])
        viewing = self._in_picture(self._mount.inv().apply(aim))
        viewing[viewing] = self._links.free(words[viewing])
        cameras = tips[viewing, :3] + turns[viewing] @ self._mount.translation
        return np.asarray(self._base.apply(cameras))

    def occupancy(self, points: FloatArray) -> FloatArray:
        """Return P of places (N, 3) for the camera [m], world: 1 where taken or out of reach."""
        far = self._reach.query(points, distance_upper_bound=NEAR_A_WORD)[0] > NEAR_A_WORD
        return np.maximum(self._blocked(points), far.astype(float))

    def camera_of(self, word: IntArray) -> RigidTransform:
        """Return the camera's pose of a word in the world, by the kinematics."""
        tip = forward(self._arm.stages, word)
        pose = RigidTransform.from_components(tip[:3], Rotation.from_matrix(tip[3:].reshape(3, 3)))
        return self._base * pose * self._mount

    def sees(self, camera: RigidTransform) -> bool:
        """Return whether a camera has all of the target in its picture, unhidden by belief."""
        rim = self.field.target.position + self.field.target.outline
        rated = rate_positions(self.field, self.lens, camera.translation)[0]
        return bool(self._in_picture(camera.inv().apply(rim)).all()) and rated.rating > 0.0

    def _in_picture(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return which points (N, 3) [m], camera frame, are in the picture with a margin."""
        pixels = self._intrinsics.pixels(points)
        size = np.array([self._intrinsics.width, self._intrinsics.height])
        return np.all((pixels > MARGIN) & (pixels < size - MARGIN), axis=1)

    def plan(self) -> Plan | None:
        """Return the best rated placement that a word of the actuators reaches, or None."""
        best = views_in_order(SpatialTask([self.field], self.lens, self.occupancy, SEARCH))
        for tries, view in enumerate(best, start=1):
            if tries > TRIES:
                return None
            word = self._word(view)
            if word is not None and self.sees(camera := self.camera_of(word)):
                return Plan(view, word, camera, tries)
        return None

    def _word(self, view: View) -> IntArray | None:
        """Solve the inverse kinematics for a placement, whichever way up the camera is best."""
        rng = np.random.default_rng(0)  # the exact search does not use it
        found, level = [], look_at(view.position, self.field.target.position)
        for roll in ROLLS:
            turn = RigidTransform.from_rotation(Rotation.from_euler("z", float(roll)))
            tip = self._base.inv() * level * turn * self._mount.inv()
            pose = np.concatenate([tip.translation, tip.rotation.as_matrix().ravel()])
            solution = solve(self._arm, pose, "kd-tree", rng, self._links)
            if solution is not None:
                found.append(solution)
        return min(found, key=lambda s: s.cost).word if found else None


def prepare(trial: PlacementTrial) -> tuple[RoverView, Plan | None, int]:
    """Draw settings until the arm at home does not see all of the target, and plan in the last.

    Returns:
        The setting with the arm at home, the plan, and the number of words that see the target.
    """
    rng = np.random.default_rng(trial.seed)
    while True:
        setting = draw_setting(rng)
        scene = RoverView(setting, trial.stages)
        if scene.seen()[0] < 1.0:
            break
    try:
        planner = BraidPlanner(scene, setting.target, believed_blocks(setting.blocks, rng))
    except PlacementError:
        return scene, None, 0
    return scene, planner.plan(), planner.seeing


@dataclasses.dataclass(frozen=True)
class PlacedCamera:
    """A camera placed by BRAID.

    Attributes:
        seen: Visible share of the target.
        pixels: Number of the target's pixels if nothing hid it.
        random: (n,) visible share from random words.
        wrong: Number of wrong bits.
        tries: Number of placements tried.
        word: (stages,) state of each stage.
        place_mm: Distance of the camera from the kinematics of its word [mm].
        turn_deg: Angle of the camera to the kinematics of its word [deg].
        off_mm: Distance of those kinematics from the placement [mm].
        off_deg: Angle of those kinematics to the placement [deg].
    """

    seen: float
    pixels: float
    random: FloatArray
    wrong: int
    tries: int
    word: IntArray
    place_mm: float
    turn_deg: float
    off_mm: float
    off_deg: float


@dataclasses.dataclass(frozen=True)
class PlacementRun:
    """One setting.

    Attributes:
        home: Visible share of the target from the arm at home.
        seeing: Number of words that see the target.
        placed: The placed camera; None if BRAID can take no placement.
    """

    home: float
    seeing: int
    placed: PlacedCamera | None = None


def run_placement(trial: PlacementTrial) -> PlacementRun:
    """Plan in one setting, drive BRAID there, and count what is seen."""
    scene, plan, seeing = prepare(trial)
    home = scene.seen()[0]
    if plan is None:
        return PlacementRun(home, seeing)
    bench = scene.bench
    drive = WireDrive(np.zeros(trial.stages, dtype=np.int64))
    drive.change(plan.word)
    bench.drive(drive)
    bench.step(REST)
    wrong = int(np.count_nonzero(bench.bits() != word_bits(plan.word)))
    seen, pixels = scene.seen()
    error = plan.transform_camera_to_world.inv() * scene.transform_camera_to_world()
    wish = plan.view.position - plan.transform_camera_to_world.translation
    aim = bench.data.geom("target").xpos - plan.transform_camera_to_world.translation
    ahead = plan.transform_camera_to_world.rotation.as_matrix()[:, 2]
    cosine = float(ahead @ aim / np.linalg.norm(aim))
    random = []
    rng = np.random.default_rng((trial.seed, 1))
    for _ in range(RANDOM_WORDS):
        bench.put(rng.integers(0, STATES, trial.stages))
        bench.step(REST)
        random.append(scene.seen()[0])
    placed = PlacedCamera(
        seen=seen,
        pixels=pixels,
        random=np.array(random),
        wrong=wrong,
        tries=plan.tries,
        word=plan.word,
        place_mm=1e3 * float(np.linalg.norm(error.translation)),
        turn_deg=float(np.rad2deg(error.rotation.magnitude())),
        off_mm=1e3 * float(np.linalg.norm(wish)),
        off_deg=float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))),
    )
    return PlacementRun(home, seeing, placed)


def _in_base(
    believed: tuple[Block, ...], margins: list[float], base: RigidTransform
) -> Callable[[FloatArray], FloatArray]:
    """Return P of places in the arm's base frame: 1 in a block that is grown by its margin."""
    planes = [ConvexHull(block.corners).equations for block in believed]

    def occupancy(points: FloatArray) -> FloatArray:
        world = base.apply(points)
        taken = np.zeros(len(points), dtype=bool)
        for faces, margin in zip(planes, margins):
            taken |= (world @ faces[:, :3].T + faces[:, 3]).max(axis=1) < margin + 0.5 * CLEARANCE
        return taken.astype(float)

    return occupancy
