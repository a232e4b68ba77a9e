"""Classification of the six contact states by a measured wrench (Thesis section A.4, figure A-6).

The wrench alone is ambiguous: forces of two contacts often add up to a force that one could give.
So the card's pose is used too, as estimated by vision and arm, with its covariance. A state is
rated by the distance that the pose must move for its features to meet, and by the distance of the
wrench from the cone of its frictional contacts there; the pose is marginalised to first order.

Assumed: rigid shapes known from CAD, dry friction of a known coefficient, planar, at rest or slow,
and that there is a contact at all.
"""

import dataclasses
import math
import operator
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from controllers.insertion.contact import (
    CORNERS,
    STATES,
    CardInSlot,
    ContactPoint,
    contact_at,
    contacts_of,
    wrench_cone,
)
from perception.geometry.arrays import FloatArray

_STEPS = 4  # Newton steps onto a state's set of poses.
_MET = 1e-4  # Largest gap after these steps [m].
_MOVE = 1e-5  # Step of the differences by the pose [m, m, rad].
_EXACT = 1e-5  # Standard deviation of the CAD's lengths [m].
_HOPELESS = 300.0  # Cost of the pose alone beyond which the wrench does not matter.


@dataclasses.dataclass(frozen=True)
class WrenchNoise:
    """Error of the wrench sensor, normal.

    Attributes:
        relative: Standard deviation as a share of the force's size; for the moment with `lever`.
        force: Standard deviation at no load [N].
        torque: Standard deviation of the moment at no load [N m].
        lever: Arm that turns a force into the moment of a full scale [m].
    """

    relative: float = 0.02
    force: float = 0.0
    torque: float = 0.0
    lever: float = 0.05

    def sigma(self, wrench: FloatArray) -> FloatArray:
        """Return (3,) standard deviations at a load (3,)."""
        size = self.relative * math.hypot(wrench[0], wrench[1])
        force = math.hypot(size, self.force)
        return np.array([force, force, math.hypot(size * self.lever, self.torque)])


@dataclasses.dataclass(frozen=True)
class StateEstimate:
    """A classified contact.

    Attributes:
        state: Contact state, 1 to 6.
        side: 1 as in `contact.STATES`, -1 for the mirror image.
        cost: Cost of the chosen hypothesis, of whitened squared distances.
        margin: Cost of the best other state less that of the chosen one.
        pose: (3,) pose estimate, moved so that the features meet.
    """

    state: int
    side: int
    cost: float
    margin: float
    pose: FloatArray


def classify(
    shape: CardInSlot,
    wrench: FloatArray,
    noise: WrenchNoise,
    pose: FloatArray,
    covariance: FloatArray,
) -> StateEstimate:
    """Return the contact state that explains wrench and pose estimate best.

    Args:
        shape: Shapes of card and slot.
        wrench: (3,) wrench by the slot on the card, card's frame [N, N, N m].
        noise: Standard deviations of the wrench's noise.
        pose: (3,) pose estimate of the card in the slot's frame [m, m, rad].
        covariance: (3, 3) covariance of the pose.

    Returns:
        The state.

    Raises:
        ValueError: If wrench or pose is not three finite numbers, or there is no load.
    """
    for name, value in (("wrench", wrench), ("pose", pose)):
        if np.shape(value) != (3,) or not np.all(np.isfinite(value)):
            raise ValueError(f"{name} {value}: expected three finite numbers")
    if not math.hypot(wrench[0], wrench[1]) > 0.0:
        raise ValueError("wrench without force: there is no contact to classify")
    rated: list[tuple[float, int, int, FloatArray]] = []
    for state in STATES:
        for side in (-1, 1):
            met = _meet(shape, pose, covariance, state, side)
            hopeless = met.cost > _HOPELESS
            cost = met.cost if hopeless else _rate(shape, wrench, noise, met, state, side)
            rated.append((cost, state, side, met.pose))
    rated.sort(key=lambda entry: entry[0])
    cost, state, side, met = rated[0]
    other = next(entry[0] for entry in rated if entry[1] != state)
    return StateEstimate(state, side, cost, other - cost, met)


class _Meeting(NamedTuple):
    """The likeliest pose where a state's features meet, its covariance, and its cost."""

    pose: FloatArray
    covariance: FloatArray
    cost: float


def _rate(
    shape: CardInSlot, wrench: FloatArray, noise: WrenchNoise, met: _Meeting, state: int, side: int
) -> float:
    """Return -2 ln of a hypothesis' evidence, but for a common constant.

    One contact's wrenches fill a plane: the moment about the contact point must vanish, and its
    variance counts. Those of two fill a volume: the moment may be any up to the leading edge's.
    """
    contacts = contacts_of(shape, met.pose, state, side)
    sigma = noise.sigma(wrench)
    cone = wrench_cone(contacts, shape.friction)
    forces, _ = nnls(cone / sigma[:, None], wrench / sigma)
    change = np.empty((3, 3))
    for axis in range(3):
        moved = met.pose.copy()
        moved[axis] += _MOVE
        other = wrench_cone(contacts_of(shape, moved, state, side), shape.friction)
        change[:, axis] = (other - cone) @ forces / _MOVE
    total = np.diag(sigma**2) + change @ met.covariance @ change.T
    # Again with the pose's share: the cone is fitted where both agree best.
    whiten = np.linalg.inv(np.linalg.cholesky(total))
    _, residual = nnls(whiten @ cone, whiten @ wrench)
    if len(contacts) == 1:
        x, y = contacts[0].point
        about = np.array([y, -x, 1.0])
        volume = 2.0 * math.pi * float(about @ total @ about)
    else:
        largest = math.hypot(wrench[0], wrench[1]) * shape.card_width / 2.0
        volume = max(largest, abs(wrench[2])) ** 2
    return met.cost + residual**2 + math.log(volume)


def _meet(
    shape: CardInSlot, pose: FloatArray, covariance: FloatArray, state: int, side: int
) -> _Meeting:
    """Move a pose estimate to the likeliest pose where a state's features meet."""
    met = pose.copy()
    for _ in range(_STEPS):
        gaps, rows, gain = _pull(contacts_of(shape, met, state, side), covariance)
        met = pose - gain @ (gaps + rows @ (pose - met))
    contacts = contacts_of(shape, met, state, side)
    gaps, rows, gain = _pull(contacts, covariance)
    if np.abs(gaps).max() > _MET:
        return _Meeting(met, covariance, math.inf)  # the steps did not converge
    density = rows @ covariance @ rows.T
    keep = np.eye(3) - gain @ rows
    left = keep @ covariance @ keep.T
    moved = met - pose
    cost = float(moved @ np.linalg.solve(covariance, moved))
    # Open gaps are uniform up to the clearance.
    clearance = shape.slot_width - shape.card_width
    cost += math.log(np.linalg.det(density * (2.0 * math.pi / clearance**2)))
    cost += _misplaced(shape, met, left, contacts, state, side)
    return _Meeting(met, left, cost)


def _pull(
    contacts: list[ContactPoint], covariance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return gaps (n,), their gradients (n, 3), and the gain (3, n) that closes them likeliest."""
    gaps = np.array([contact.gap for contact in contacts])
    rows = np.array([contact.gradient for contact in contacts])
    return gaps, rows, covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T)


def _misplaced(
    shape: CardInSlot,
    met: FloatArray,
    covariance: FloatArray,
    contacts: list[ContactPoint],
    state: int,
    side: int,
) -> float:
    """Return the cost of points beyond their features, and of other features that overlap."""
    variance = covariance[0, 0] + covariance[1, 1] + _EXACT**2
    cost = sum(contact.excess**2 for contact in contacts) / variance
    own = {(touch, side * sign) for touch, sign in STATES[state]}
    for other in (-1, 1):
        for pair in CORNERS:
            contacts = [contact_at(shape, met, touch, other) for touch in pair]
            least = max(contacts, key=operator.attrgetter("gap"))
            if least.gap < 0.0 and own.isdisjoint((touch, other) for touch in pair):
                variance = float(least.gradient @ covariance @ least.gradient)
                cost += least.gap**2 / (variance + _EXACT**2)
    return cost
