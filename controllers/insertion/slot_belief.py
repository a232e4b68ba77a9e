"""The slave's estimate of the slot's pose, in the frame of its dead reckoning.

The master's views arrive late and at a low rate. Each is combined with the pose of the slave at the
time of its images; between them the slot is at rest in the frame of dead reckoning, whose drift is
the process noise.
"""

import dataclasses
import math
from collections import deque

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.guidance import Guidance
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, point_jacobian, transport_covariance

_SIMULTANEOUS = 0.05  # Largest time difference of images and joint angles [s].
_NO_SLIP = np.zeros(6)


@dataclasses.dataclass(frozen=True)
class BeliefConfig:
    """Process noise of the slot's pose, and the gate of the master's views.

    Attributes:
        drift: Relative error of the distance driven.
        turn_drift: Relative error of the angle turned.
        veer: Uncommanded turn per distance [rad/m].
        bump: Tilt per distance that the inclinometer misses [rad/m], and rise per distance.
        stretch: Correlation lengths of these errors: distance [m] and turn [rad].
        rest_drift: Standard deviations of turn [rad] and position [m] that a second at rest adds.
        card: Standard deviations of turn [rad] and position [m] of the card from joint angles.
        gate: Squared Mahalanobis distance beyond which a view is refused (6 degrees of freedom).
        refusals: Number of consecutive refused views after which the next one is accepted.
        memory: Time for which poses of the card are stored [s].
    """

    drift: float = 0.1
    turn_drift: float = 0.15
    veer: float = 0.2
    bump: float = 0.1
    stretch: tuple[float, float] = (0.05, 0.1)
    rest_drift: tuple[float, float] = (2e-4, 2e-4)
    card: tuple[float, float] = (2e-3, 5e-4)
    gate: float = 30.0
    refusals: int = 3
    memory: float = 3.0


class SlotBelief:
    """A Kalman filter for a slot at rest.

    Args:
        transform_slot_to_start: Prior transform from the slot to the frame of dead reckoning.
        covariance: (6, 6) covariance of that transform, as a twist in the frame of dead reckoning.
        config: Process noise and gate.

    Attributes:
        slot_in_start: (4, 4) transform from the slot to the frame of dead reckoning.
        covariance: (6, 6) covariance of xi in ``true = from_exp_coords(xi) * slot_in_start``.
        innovation: Squared Mahalanobis distance of the last view from the estimate.
        refused: Number of consecutive refused views.
        transform_slot_to_card: The last used view, moved on by the card's own motion since its
            images; None before the first.
    """

    def __init__(
        self, transform_slot_to_start: RigidTransform, covariance: FloatArray, config: BeliefConfig
    ) -> None:
        self.slot_in_start = transform_slot_to_start.as_matrix()
        self.covariance = np.array(covariance, dtype=float)
        self.innovation, self.refused = math.nan, 0
        self.transform_slot_to_card: RigidTransform | None = None
        self._config = config
        self._where: deque[tuple[float, FloatArray]] = deque()
        self._drifted = np.zeros(3)  # Distance, turn and time since the last view.
        self._slip = self._slip_before = _NO_SLIP  # Now and at the last view.

    def note(
        self,
        time: float,
        card_in_start: FloatArray,
        driven: float,
        turned: float,
        period: float,
        slip: FloatArray = _NO_SLIP,
    ) -> None:
        """Store the card's pose, and accumulate the motion for the drift.

        Args:
            time: Robot time [s].
            card_in_start: (4, 4) pose of the card from joint angles and dead reckoning.
            driven: Distance driven since the last call [m].
            turned: Angle turned since the last call [rad].
            period: Time since the last call [s].
            slip: (6,) twist by which dead reckoning errs if the turn share does, see `Odometry`.
        """
        self._where.append((time, card_in_start))
        while self._where[0][0] < time - self._config.memory:
            self._where.popleft()
        self._drifted += [driven, turned, period]
        self._slip = slip

    def deviation(self) -> float:
        """Return the largest standard deviation of the slot's position in its plane [m]."""
        self._drift()
        plane = self.slot_in_start[:3, :2].T @ point_jacobian(self.slot_in_start[:3, 3])
        return float(np.sqrt(np.linalg.eigvalsh(plane @ self.covariance @ plane.T)[-1]))

    def take(self, guidance: Guidance) -> bool:
        """Update the estimate by a measurement of the master.

        Args:
            guidance: Measurement of the master.

        Returns:
            Whether it was used; not if it has no pose, is too old, or beyond the gate.
        """
        seen = guidance.transform_slot_to_card
        if seen is None or not self._where:
            return False
        time, matrix = min(self._where, key=lambda entry: abs(entry[0] - guidance.time))
        if abs(time - guidance.time) > _SIMULTANEOUS:
            return False
        self._drift()
        card, believed = (RigidTransform.from_matrix(m) for m in (matrix, self.slot_in_start))
        own = np.diag(np.repeat(np.square(self._config.card), 3))
        noise = composed_covariance(card, np.zeros((6, 6)), guidance.covariance + own)
        error = np.asarray((card * seen * believed.inv()).as_exp_coords())
        total = self.covariance + noise
        self.innovation = float(error @ np.linalg.solve(total, error))
        if self.innovation > self._config.gate and self.refused < self._config.refusals:
            self.refused += 1
            return False
        if self.refused >= self._config.refusals:
            # Consistently refused views: the estimate was wrong.
            self.covariance = self.covariance + np.outer(error, error)
            total = self.covariance + noise
        self.refused = 0
        now = RigidTransform.from_matrix(self._where[-1][1])
        self.transform_slot_to_card = now.inv() * card * seen
        gain = np.linalg.solve(total, self.covariance).T
        corrected = RigidTransform.from_exp_coords(gain @ error) * believed
        self.slot_in_start = corrected.as_matrix()
        left = np.eye(6) - gain
        self.covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return True

    def _drift(self) -> None:
        """Add the drift of dead reckoning since the last view, about the robot's position."""
        if not self._where:
            return  # No motion yet.
        config = self._config
        (driven, turning), period = self._drifted[:2] * config.stretch, self._drifted[2]
        self._drifted = np.zeros(3)
        yaw = config.turn_drift**2 * turning + config.veer**2 * driven
        tilt, along = config.bump**2 * driven, config.drift**2 * driven
        drift = np.diag([tilt, tilt, yaw, 0.1 * along, along, tilt])
        rest = np.diag(np.repeat(np.square(config.rest_drift), 3) * period)
        # The card's position approximates the robot's centre of rotation.
        robot = RigidTransform.from_matrix(self._where[-1][1])
        self.covariance = self.covariance + transport_covariance(robot, drift + rest)
        slip, self._slip_before = self._slip - self._slip_before, self._slip
        self.covariance += np.outer(slip, slip)
