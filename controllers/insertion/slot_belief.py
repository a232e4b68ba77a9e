"""Where the slave believes the slot to be, in the frame of its dead reckoning.

Looks of the master come late and seldom. Each is brought to the place where the slave was when the
images were taken; between them the slot stands still in the frame of dead reckoning, whose drift is
the uncertainty that grows.
"""

import dataclasses
from collections import deque

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.guidance import Guidance
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, point_jacobian, transport_covariance

_SIMULTANEOUS = 0.05  # Between images and joint angles that count as of one moment [s].


@dataclasses.dataclass(frozen=True)
class BeliefConfig:
    """How fast what is believed grows uncertain, and what is refused.

    Attributes:
        drift: Error of the way driven, over it.
        turn_drift: Error of the angle turned, over it.
        veer: Turn that nobody asked for, over the way [rad/m].
        bump: Tilt [rad] over the way [m] that the inclinometer misses, and rise over the way.
        stretch: Way [m] and turn [rad] over which these errors stay alike.
        standing: Deviations of turn [rad] and place [m] that a second at rest adds.
        card: Deviations of turn [rad] and place [m] of the card by the arm's joints.
        gate: Squared distance, whitened, beyond which a look is refused (six degrees of freedom).
        refusals: Looks in a row after which the next one is believed all the same.
        memory: How long the slave remembers where the card was [s].
    """

    drift: float = 0.1
    turn_drift: float = 0.15
    veer: float = 0.2
    bump: float = 0.1
    stretch: tuple[float, float] = (0.05, 0.1)
    standing: tuple[float, float] = (2e-4, 2e-4)
    card: tuple[float, float] = (2e-3, 5e-4)
    gate: float = 30.0
    refusals: int = 3
    memory: float = 3.0


class SlotBelief:
    """A Kalman filter for a slot that stands still.

    Attributes:
        slot_in_start: (4, 4) from the slot to the frame of dead reckoning.
        covariance: (6, 6) of xi in ``true = from_exp_coords(xi) * slot_in_start``.
        innovation: Squared distance, whitened, of the last look from what was believed.
        refused: Looks refused in a row.
    """

    def __init__(
        self, slot_in_start: FloatArray, covariance: FloatArray, config: BeliefConfig
    ) -> None:
        """Begin with what the map says.

        Args:
            slot_in_start: (4, 4).
            covariance: (6, 6) of its xi.
            config: Noises.
        """
        self.slot_in_start = np.array(slot_in_start, dtype=float)
        self.covariance = np.array(covariance, dtype=float)
        self.innovation = float("nan")
        self.refused = 0
        self._config = config
        self._where: deque[tuple[float, FloatArray]] = deque()
        self._drifted = np.zeros(3)  # way, turn and time since the last look

    def note(
        self, time: float, card_in_start: FloatArray, way: float, turned: float, period: float
    ) -> None:
        """Remember where the card is now, and how it came there.

        Args:
            time: [s].
            card_in_start: (4, 4) by joints and dead reckoning.
            way: Driven since the last call [m].
            turned: Turned since then [rad].
            period: Passed since then [s].
        """
        self._where.append((time, card_in_start))
        while self._where[0][0] < time - self._config.memory:
            self._where.popleft()
        self._drifted += [way, turned, period]

    def deviation(self) -> float:
        """Return the larger standard deviation of the slot's place in its plane now [m]."""
        self._drift()
        plane = self.slot_in_start[:3, :2].T @ point_jacobian(self.slot_in_start[:3, 3])
        return float(np.sqrt(np.linalg.eigvalsh(plane @ self.covariance @ plane.T)[-1]))

    def take(self, guidance: Guidance) -> bool:
        """Take a look of the master.

        Args:
            guidance: With a pose.

        Returns:
            Whether it was used: it may be too old, or too far from what is believed.
        """
        seen = guidance.transform_slot_to_card
        if seen is None or not self._where:
            return False
        time, matrix = min(self._where, key=lambda entry: abs(entry[0] - guidance.time))
        if abs(time - guidance.time) > _SIMULTANEOUS:
            return False
        self._drift()
        card = RigidTransform.from_matrix(matrix)
        believed = RigidTransform.from_matrix(self.slot_in_start)
        own = np.diag(np.repeat(np.square(self._config.card), 3))
        noise = composed_covariance(card, np.zeros((6, 6)), guidance.covariance + own)
        error = np.asarray((card * seen * believed.inv()).as_exp_coords())
        spread = self.covariance + noise
        self.innovation = float(error @ np.linalg.solve(spread, error))
        if self.innovation > self._config.gate and self.refused < self._config.refusals:
            self.refused += 1
            return False
        if self.refused >= self._config.refusals:
            # It was not the looks that were wrong.
            self.covariance = self.covariance + np.outer(error, error)
            spread = self.covariance + noise
        self.refused = 0
        gain = np.linalg.solve(spread, self.covariance).T
        corrected = RigidTransform.from_exp_coords(gain @ error) * believed
        self.slot_in_start = corrected.as_matrix()
        left = np.eye(6) - gain
        self.covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return True

    def _drift(self) -> None:
        """Add what dead reckoning has lost since the last look, about where the robot is."""
        if not self._where:
            return  # Not moved yet.
        config = self._config
        way, turned, period = self._drifted
        self._drifted = np.zeros(3)
        driven, turning = way * config.stretch[0], turned * config.stretch[1]
        yaw = config.turn_drift**2 * turning + config.veer**2 * driven
        tilt, along = config.bump**2 * driven, config.drift**2 * driven
        drift = np.diag([tilt, tilt, yaw, 0.1 * along, along, tilt])
        rest = np.diag(np.repeat(np.square(config.standing), 3) * period)
        # The card is near enough to where the robot turns.
        robot = RigidTransform.from_matrix(self._where[-1][1])
        self.covariance = self.covariance + transport_covariance(robot, drift + rest)
