"""The master: it measures the poses of card and slot, and moves its camera to the best view.

It estimates the slot's pose in its own frame: first from the map, then from its detections. In a
view without the slot that estimate is used instead. The camera moves to the best view of card and
slot within the arm's reach (chapter 4), again and again as the card comes nearer.
"""

import dataclasses
import math
from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import GAP
from controllers.insertion.guidance import Guidance
from controllers.insertion.watching import SeenParts, Surroundings, WatchPlan, best_angles
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import adjoint, transport_covariance
from perception.markers.bodies import find_bodies
from perception.markers.ellipses import MarkerExpectation
from perception.markers.poses import BodyCad, BodyFit, BodyPrior
from perception.stereo.geometry import CALIBRATION_ERRORS, StereoGeometry
from twin.robot import ArmMode, Command, Observation, WheelMode


@dataclasses.dataclass(frozen=True)
class MarkerGuideConfig:
    """Markers, detector and placement of the master's camera.

    Attributes:
        card: Markers of the card.
        slot: Markers of the slot.
        diameter: Diameter of a marker [m].
        plan: Candidate camera poses; None keeps the camera at its pose.
        detector: Name of the marker detector, in `perception.markers.bodies.DETECTORS`.
        turned: Prior standard deviation of the card's attitude [rad].
        wander: Standard deviations of turn [rad] and position [m] by which the slot's covariance
            grows before a view: the robot moves on its springs between detections of the slot.
        again: Time between choices of the camera pose [s].
        lost: Time without a pair that shows both from which on their poses are not sure [s].
        aside: Longest way of a joint while the camera follows the card alone [rad]: on a longer one
            it would be outrun.
        better: Factor by which another camera pose must rate higher.
        rate: Largest rate of a joint while the camera moves [rad/s].
        exposure: Exposure time of the images [s].
        blur: Largest motion of a marker's image within an exposure, by the camera's own motion
            [px]: a quarter of the radius of a marker at half a metre.
        memory: Time for which joint angles are stored [s]; a pair that is older gives no pose.
        period: Servo tick [s].
    """

    card: BodyCad
    slot: BodyCad
    diameter: float
    plan: WatchPlan | None
    detector: str = "blob"
    turned: float = 0.3
    wander: tuple[float, float] = (1e-3, 3e-4)
    again: float = 1.0
    lost: float = 2.0
    aside: float = 0.5
    better: float = 1.15
    rate: float = 0.5
    exposure: float = 0.0
    blur: float = 1.0
    memory: float = 3.0
    period: float = 0.01


class MarkerGuide:
    """Drives the master's arm and turns its stereo pairs into guidance.

    The camera stays at its pose until card or slot is detected.

    Args:
        config: Markers, detector and placement of the camera.
        arm: Arm with the camera.
        geometry: Geometry of the stereo pair.
        slot: Prior transform from the slot to the robot, and its covariance (6, 6).
        card: Approximate transform from the card to the robot.
        angles: (4,) initial goal of the joint angles [rad].
        about: What stands about card and slot, robot frame; None for nothing.

    Attributes:
        config: Markers, detector and placement of the camera.
        transform_slot_to_robot: Estimate of the slot's pose.
        slot_covariance: (6, 6) covariance of the slot's pose, as a twist in the robot frame.
        transform_card_to_robot: Estimate of the card's pose.
        fits: Fits of card and slot in the last pair; None for a body that was not detected.
        moves: Number of changes of the camera's goal.
    """

    def __init__(
        self,
        config: MarkerGuideConfig,
        arm: SerialChain,
        geometry: StereoGeometry,
        slot: tuple[RigidTransform, FloatArray],
        card: RigidTransform,
        angles: FloatArray,
        about: Surroundings | None = None,
    ) -> None:
        self.config, self._about = config, about
        self.transform_slot_to_robot, self.slot_covariance = slot
        self.transform_card_to_robot = card
        self.fits: tuple[BodyFit | None, BodyFit | None] = (None, None)
        self.moves = 0
        self._arm, self._geometry = arm, geometry
        self._goal = angles
        self._wanted = np.empty(0)  # Joint angles; empty before the first step.
        self._angles: deque[tuple[float, FloatArray]] = deque()
        self._slot_by_calibration = np.zeros((6, CALIBRATION_ERRORS))
        # xi of the camera by errors of arm and head when the slot was last seen, robot frame.
        self._seen_with: FloatArray | None = None
        self._stamp, self._next = math.nan, 0.0
        self._found, self._both_seen = False, -math.inf  # Whether any, and when last both.
        self._pair: NDArray[np.uint8] = np.empty(0, np.uint8)

    def begin(self) -> FloatArray:
        """Choose the camera's first goal from the prior poses; return joint angles (4,) [rad].

        Where no pose shows both as they are, it is that for a card aligned before the slot, and
        where none shows that either, one that shows the card.
        """
        if not self._place(sure=False):
            ahead = RigidTransform.from_translation([0.0, -GAP, 0.0])
            self._place(sure=False, card=self.transform_slot_to_robot * ahead)
        return self._goal

    def step(self, seen: Observation) -> tuple[Command, Guidance | None]:
        """Process an observation; return the next command, and guidance after each new pair.

        Args:
            seen: Observation of the master.
        """
        if not (seen.arm_angles.usable and np.isfinite(seen.arm_angles.value).all()):
            return Command(), None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        if not len(self._wanted):
            self._wanted = angles.copy()
        self._note(seen.arm_angles.stamp, angles)
        guidance = None
        if seen.stereo.usable and seen.stereo.stamp != self._stamp:
            self._stamp = seen.stereo.stamp
            old = seen.arm_angles.stamp - self._stamp > self.config.memory
            pair = np.asarray(seen.stereo.value, dtype=np.uint8)
            guidance = self._unseen() if old else self._view(pair)
        sure = seen.time < self._both_seen + self.config.lost
        # Until the first detection the camera keeps its pose. While it sees the card alone it
        # follows it.
        if self._found and (seen.time >= self._next or guidance is not None and not sure):
            self._next = seen.time + self.config.again
            self._place(sure)
        return self._move(), guidance

    def _note(self, time: float, angles: FloatArray) -> None:
        """Store joint angles by their time."""
        self._angles.append((time, angles))
        while self._angles[0][0] < time - self.config.memory:
            self._angles.popleft()

    def _angles_at(self, time: float) -> FloatArray:
        """Return the joint angles (4,) at a time; before the first step the arm was at rest."""
        times, angles = zip(*self._angles, strict=True)
        return np.array([np.interp(time, times, joint) for joint in np.transpose(angles)])

    def _view(self, pair: NDArray[np.uint8]) -> Guidance:
        """Detect card and slot in a pair; a repeated pair is of a frozen camera and gives none."""
        frozen, self._pair = np.array_equal(self._pair, pair), pair
        if frozen:
            return self._unseen()
        config, angles = self.config, self._angles_at(self._stamp)
        camera = self._arm.tool_in_robot(angles)
        to_camera = camera.inv()
        slot, covariance, slot_shared = self._slot_before(angles)
        loose = np.diag([config.turned**-2] * 3 + [0.0] * 3)
        priors = (
            BodyPrior(to_camera * self.transform_card_to_robot, loose),
            BodyPrior(slot, np.asarray(np.linalg.inv(covariance), dtype=float), slot_shared),
        )
        bodies, (near, far) = (config.card, config.slot), self._ranges(to_camera)
        expected = MarkerExpectation(near, far, config.diameter)
        card_fit, slot_fit = find_bodies(
            pair, self._geometry, bodies, expected, config.detector, priors
        )
        self.fits = (card_fit, slot_fit)
        self._found |= card_fit is not None or slot_fit is not None
        if card_fit is not None and slot_fit is not None:
            self._both_seen = self._stamp
        if slot_fit is not None:
            slot, covariance = slot_fit.transform_body_to_camera, slot_fit.covariance
            slot_shared, self._seen_with = slot_fit.by_calibration, self._arm.error_jacobian(angles)
            self.transform_slot_to_robot = camera * slot
            self.slot_covariance = transport_covariance(camera, covariance)
            self._slot_by_calibration = adjoint(camera) @ slot_shared
        if card_fit is None:
            return Guidance(self._stamp, False, slot_fit is not None)
        card = card_fit.transform_body_to_camera
        self.transform_card_to_robot = camera * card
        # What the calibration moves alike cancels.
        both = slot_shared @ card_fit.by_calibration.T
        apart = covariance + card_fit.covariance - both - both.T
        relative = transport_covariance(card.inv(), apart)
        return Guidance(self._stamp, True, slot_fit is not None, card.inv() * slot, relative)

    def _unseen(self) -> Guidance:
        """Return guidance by a pair in which nothing was looked for."""
        self.fits = (None, None)
        return Guidance(self._stamp, False, False)

    def _slot_before(self, angles: FloatArray) -> tuple[RigidTransform, FloatArray, FloatArray]:
        """Return the slot in the camera before a view, its covariance and xi by the calibration.

        Errors of arm and head cancel for a camera that has not moved since the slot was seen.

        Args:
            angles: (4,) joint angles at the view [rad].
        """
        to_camera = self._arm.tool_in_robot(angles).inv()
        turn, place = np.square(self.config.wander)
        covariance = self.slot_covariance + np.diag([turn] * 3 + [place] * 3)
        left = self._arm.error_jacobian(angles)
        if self._seen_with is not None:
            left = left - self._seen_with
        covariance += left @ self._arm.error_covariance() @ left.T
        return (
            to_camera * self.transform_slot_to_robot,
            transport_covariance(to_camera, covariance),
            adjoint(to_camera) @ self._slot_by_calibration,
        )

    def _ranges(self, to_camera: RigidTransform) -> tuple[float, float]:
        """Return the range of distances at which markers are expected [m]."""
        parts = self._parts()
        bodies = (parts.slot_pose, parts.slot), (parts.card_pose, parts.card)
        depths = np.concatenate(
            [(to_camera * pose).apply(cad.points)[:, 2] for pose, cad in bodies]
        )
        return max(0.8 * float(depths.min()), 0.2), max(1.25 * float(depths.max()), 0.3)

    def _parts(self) -> SeenParts:
        """Return the estimated poses of card and slot, robot frame."""
        card, slot = self.transform_card_to_robot, self.transform_slot_to_robot
        return SeenParts(card, slot, self.config.card, self.config.slot)

    def _place(self, sure: bool, card: RigidTransform | None = None) -> bool:
        """Set a clearly better camera pose as the goal; return whether any shows both.

        Args:
            sure: Whether card and slot were seen lately, both in one pair.
            card: Pose of the card, robot frame; None for its estimate.
        """
        plan = self.config.plan
        if plan is None:
            return False
        follows = self._found and not sure
        farthest = self.config.aside if follows else math.inf
        parts = self._parts()
        if card is not None:
            parts = dataclasses.replace(parts, card_pose=card)
        found = best_angles(
            plan, parts, self._arm, self._geometry, self._goal, sure, farthest, self._about
        )
        better = found.rating > self.config.better * found.rating_now
        # A card alone is followed, not seen better; where it will come nothing is seen of it yet.
        alone = found.rating_now == 0.0 and card is None
        if better and (found.whole or alone):
            self._goal = found.angles
            self.moves += 1
        return found.whole

    def _move(self) -> Command:
        """Move the joints a step towards the goal."""
        still = np.zeros(4)
        rates, step = still, self._goal - self._wanted
        if self._found and step.any():
            most = self.config.rate * self.config.period
            # All joints arrive at the same time.
            step = step * min(1.0, most / max(float(np.abs(step).max()), 1e-12))
            step = step * min(1.0, self.config.blur / max(self._blur(step), 1e-12))
            self._wanted = self._wanted + step
            rates = step / self.config.period
        return Command(still, self._wanted, WheelMode.SPEED, ArmMode.POSITION, rates)

    def _blur(self, step: FloatArray) -> float:
        """Return how far a tick's step (4,) [rad] moves a marker's image in an exposure [px]."""
        cameras = self._arm.tool_in_robot(np.stack([self._wanted, self._wanted + step]))
        markers = self._parts().markers()
        before, after = (self._geometry.pixels(camera.inv().apply(markers)) for camera in cameras)
        moved = float(np.nan_to_num(np.linalg.norm(after - before, axis=1)).max())
        return moved * self.config.exposure / self.config.period
