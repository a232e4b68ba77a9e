"""The master: it looks at card and slot, tells the slave, and keeps its camera well placed.

It believes where the slot is in its own frame: by the map at first, by its looks as soon as one
shows it. What a look does not show is left to that belief. Its camera goes where card and slot are
seen best of all places within the arm's reach (chapter 4), anew as the card comes nearer.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.insertion.guidance import Guidance
from controllers.insertion.watching import SeenParts, WatchPlan, best_angles
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, inverse_covariance
from perception.markers.bodies import find_bodies
from perception.markers.ellipses import MarkerExpectation
from perception.markers.poses import BodyCad, BodyFit, BodyPrior
from perception.stereo.geometry import StereoGeometry
from twin.robot import ArmMode, Command, Observation, WheelMode


@dataclasses.dataclass(frozen=True)
class MarkerGuideConfig:
    """How the master looks.

    Attributes:
        card: Markers of the card.
        slot: Markers of the slot.
        diameter: Diameter of a marker [m].
        plan: How the camera is placed; None leaves it where it is.
        detector: Name in `perception.markers.bodies.DETECTORS`.
        turned: Deviation of the card's attitude from the slot's, before it is seen [rad].
        wander: Deviations of turn [rad] and place [m] by which the slot's belief is widened for a
            look: the robot has moved on its springs since the last that showed the slot.
        again: Time between placements [s].
        better: Factor by which another place must rate higher.
        rate: Largest rate of a joint while the camera moves [rad/s].
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
    better: float = 1.15
    rate: float = 0.5
    period: float = 0.01


class MarkerGuide:
    """Drives the master's arm and turns its stereo pairs into guidance."""

    def __init__(
        self,
        config: MarkerGuideConfig,
        arm: SerialChain,
        geometry: StereoGeometry,
        slot: tuple[RigidTransform, FloatArray],
        card: RigidTransform,
        angles: FloatArray | None = None,
    ) -> None:
        """Begin with what the map says.

        Args:
            config: How it looks.
            arm: With the camera.
            geometry: Geometry of the stereo pair.
            slot: The transform from the slot to the robot and its covariance (6, 6).
            card: The transform from the card to the robot, roughly.
            angles: (4,) of the joints where the camera shall be [rad], until a better place is
                found. Nothing moves before card or slot is seen.
        """
        self.config = config
        self.slot, self.slot_covariance = slot
        self.card = card
        self.fits: tuple[BodyFit | None, BodyFit | None] = (None, None)
        self.moves = 0
        self._arm, self._geometry = arm, geometry
        self._goal = angles
        self._wanted: FloatArray | None = None
        self._looked = float("nan")
        self._next = 0.0
        self._found = False
        self._pair: NDArray[np.uint8] | None = None

    def begin(self, angles: FloatArray) -> FloatArray:
        """Choose where the camera begins, by the map alone.

        Args:
            angles: (4,) of the joints if there is no better place [rad].

        Returns:
            (4,) of the joints [rad].
        """
        if self._goal is None:
            self._goal = angles
        if self.config.plan is not None:
            self._place(self._goal)
        return self._goal

    def step(self, seen: Observation) -> tuple[Command, Guidance | None]:
        """Take what was measured; return the next command, and guidance after each new pair.

        Args:
            seen: Observation of the master.
        """
        if not (seen.arm_angles.usable and np.isfinite(seen.arm_angles.value).all()):
            return Command(), None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        if self._wanted is None:
            self._wanted = angles.copy()
        guidance = None
        if seen.stereo.usable and seen.stereo.stamp != self._looked:
            self._looked = seen.stereo.stamp
            guidance = self._look(seen, angles) if self._is_new(seen) else self._nothing(seen)
        # Before anything is seen, the camera waits where it was placed.
        if self.config.plan is not None and self._found and seen.time >= self._next:
            self._next = seen.time + self.config.again
            self._place(angles)
        return self._move(), guidance

    def _is_new(self, seen: Observation) -> bool:
        """Say whether a pair differs from the one before: no two have the same noise."""
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        frozen = self._pair is not None and np.array_equal(self._pair, pair)
        self._pair = pair
        return not frozen

    def _nothing(self, seen: Observation) -> Guidance:
        """Tell that a frozen camera shows nothing."""
        self.fits = (None, None)
        return Guidance(seen.stereo.stamp, False, False, None, np.zeros((6, 6)))

    def _look(self, seen: Observation, angles: FloatArray) -> Guidance:
        """Find card and slot in a pair."""
        config = self.config
        camera = self._arm.tool_in_robot(angles)
        to_camera = camera.inv()
        turn, place = np.square(config.wander)
        spread = self.slot_covariance + np.diag([turn] * 3 + [place] * 3)
        slot = to_camera * self.slot
        spread = composed_covariance(to_camera, np.zeros((6, 6)), spread)
        loose = np.diag([config.turned**-2] * 3 + [0.0] * 3)
        near, far = self._ranges(to_camera)
        fits = find_bodies(
            np.asarray(seen.stereo.value, dtype=np.uint8),
            self._geometry,
            (config.card, config.slot),
            MarkerExpectation(near, far, config.diameter),
            config.detector,
            (
                BodyPrior(to_camera * self.card, loose),
                BodyPrior(slot, np.asarray(np.linalg.inv(spread), dtype=float)),
            ),
        )
        card_fit, slot_fit = fits
        self.fits = (card_fit, slot_fit)
        self._found |= card_fit is not None or slot_fit is not None
        if slot_fit is not None:
            slot, spread = slot_fit.transform_body_to_camera, slot_fit.covariance
            self.slot = camera * slot
            self.slot_covariance = composed_covariance(camera, np.zeros((6, 6)), spread)
        if card_fit is None:
            return Guidance(seen.stereo.stamp, False, slot_fit is not None, None, np.zeros((6, 6)))
        card = card_fit.transform_body_to_camera
        self.card = camera * card
        back = inverse_covariance(card, card_fit.covariance)
        relative = composed_covariance(card.inv(), back, spread)
        pose = card.inv() * slot
        return Guidance(seen.stereo.stamp, True, slot_fit is not None, pose, relative)

    def _ranges(self, to_camera: RigidTransform) -> tuple[float, float]:
        """Return the range of distances at which markers are expected [m]."""
        ahead = [
            (to_camera * pose).apply(cad.points)[:, 2]
            for pose, cad in ((self.slot, self.config.slot), (self.card, self.config.card))
        ]
        depths = np.concatenate(ahead)
        return max(0.8 * float(depths.min()), 0.2), max(1.25 * float(depths.max()), 0.3)

    def _place(self, angles: FloatArray) -> None:
        """Take the camera to a clearly better place, if there is one."""
        assert self.config.plan is not None
        parts = SeenParts(self.card, self.slot, self.config.card, self.config.slot)
        now = self._goal if self._goal is not None else angles
        found = best_angles(self.config.plan, parts, self._arm, self._geometry, now)
        if found.rating > self.config.better * found.rating_now:
            self._goal = found.angles
            self.moves += 1

    def _move(self) -> Command:
        """Bring the joints a step nearer to where they shall be."""
        assert self._wanted is not None
        still = np.zeros(4)
        rates = still
        if self._goal is not None and self._found:
            most = self.config.rate * self.config.period
            step = self._goal - self._wanted
            # All joints arrive at once.
            step = step * min(1.0, most / max(float(np.abs(step).max()), 1e-12))
            self._wanted = self._wanted + step
            rates = step / self.config.period
        return Command(still, self._wanted, WheelMode.SPEED, ArmMode.POSITION, rates)
