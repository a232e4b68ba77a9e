"""The bench of ch5-contact: a card on a compliant hand at a slot, and its true contacts."""

import dataclasses
import math

import mujoco
import numpy as np

from controllers.insertion.contact import STATES, CardInSlot, Touch, turn
from models.card_and_slot.build import build_bench
from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray
from twin.describe import describe_rover
from twin.optics.realism import RealismName
from twin.realism import realism_of
from twin.sensors import IDEAL, ChannelSpec, with_errors

NEAR = 5e-4
"""Distance within which a contact is at a corner [m]; the solver's overlap stays below 0.1 mm."""
_HAND = 6  # Joints of the hand; they come first.
_PLANE = [0, 1, 5]  # The hand's joints in the slot's plane: across, ahead and turn.
LEAST_SHARE = 0.05
"""A contact with less of the largest force does not count."""

_NAMED: dict[frozenset[tuple[Touch | None, int]], tuple[int, int]] = {
    frozenset((touch, side * sign) for touch, sign in contacts): (state, side)
    for state, contacts in STATES.items()
    for side in (-1, 1)
}


def shape_of(width: float) -> CardInSlot:
    """Return card and slot as the CAD has them, for a slot width [m]."""
    sheet = CARD_AND_SLOT
    return CardInSlot(
        sheet.card_width, sheet.card_length, width, sheet.slot_depth, sheet.wall, sheet.friction
    )


@dataclasses.dataclass(frozen=True)
class HandAsMade:
    """A hand and its sensor that are not their drawings.

    Attributes:
        springs: (6,) stiffness of each spring over that of the drawing.
        dampers: (6,) the same of each damper.
        sensor: Errors of the wrench sensor.
    """

    springs: FloatArray
    dampers: FloatArray
    sensor: ChannelSpec

    @classmethod
    def drawn_from(cls, realism: RealismName, rng: np.random.Generator) -> "HandAsMade | None":
        """Return a hand within the tolerances of a set; None if that has none.

        The hand is arm and suspension as one compliance, so its springs have the suspension's
        tolerance, and its sensor is the arm's.

        Args:
            realism: Name of the set.
            rng: Random generator of the hand and of its sensor's errors.
        """
        named = realism_of(realism)
        tolerances, errors = named.tolerances, named.sensor_errors
        if tolerances is None or errors is None:
            return None
        springs, dampers = (
            rng.uniform(1.0 - share, 1.0 + share, 6)
            for share in (tolerances.spring, tolerances.damper)
        )
        suite = with_errors(IDEAL, errors, describe_rover(), rng)
        return cls(springs, dampers, suite.channels["arm_base_wrench"])


class HandBench:
    """A card in a hand that moves in all six directions.

    Poses (6,) are positions along the slot's axes [m], then turns about them, one after the other
    [rad].

    Args:
        model: Bench as compiled, with the card at its origin.
        hand: Hand and its sensor as made; None for the hand as drawn, with an exact sensor.
    """

    def __init__(self, model: mujoco.MjModel, hand: HandAsMade | None = None) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self._sensor = ChannelSpec() if hand is None else hand.sensor
        if hand is not None:
            self.model.jnt_stiffness[:_HAND] *= hand.springs
            self.model.dof_damping[:_HAND] *= hand.dampers
        self.stiffness = self.model.jnt_stiffness[:_HAND].copy()
        self._wanted, self._wrench = np.zeros(_HAND), np.zeros(6)

    def put(self, pose: FloatArray, command: FloatArray | None = None) -> None:
        """Put the card at a pose (6,), at rest, and begin anew.

        Args:
            pose: Pose of the card.
            command: Pose that the hand is commanded to; None for the same.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:_HAND] = pose
        self._wanted = np.array(pose if command is None else command, dtype=float)
        self.model.qpos_spring[:_HAND] = self._wanted

    def move(self, pose: FloatArray) -> None:
        """Let the next step take the hand to a pose (6,)."""
        self._wanted = np.array(pose, dtype=float)

    def step(self, seconds: float) -> float:
        """Advance by a time [s] and return the largest contact force meanwhile [N]."""
        largest, model = 0.0, self.model
        count = max(1, round(seconds / model.opt.timestep))
        rest = model.qpos_spring[:_HAND].copy()
        way = (self._wanted - rest) / count
        # Springs and dampers are those between the card and a hand that moves.
        self.data.qfrc_applied[:_HAND] = model.dof_damping[:_HAND] * way / model.opt.timestep
        for tick in range(count):
            model.qpos_spring[:_HAND] = rest + (tick + 1) * way
            mujoco.mj_step(model, self.data)
            if self.data.ncon:
                largest = max(largest, float(np.linalg.norm(self.contact_force())))
        return largest

    @property
    def felt(self) -> FloatArray:
        """(6,) what the slot puts on the card as the hand's sensor has it, without noise."""
        of, true = self._sensor, -self.data.sensordata[:6]
        shown = np.asarray(of.scale) * true + of.bias
        shown -= np.asarray(of.drift) * math.expm1(-self.data.time / of.warm_up)
        if of.cross is not None:
            shown += np.array(of.cross) @ true
        return shown

    def contact_force(self) -> FloatArray:
        """(3,) what the contacts truly put on the card, slot's frame [N]."""
        return sum((force for _, force in self._contacts()), np.zeros(3))

    def _contacts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Points and forces on the card, (3,) each, slot's frame."""
        result, plate = [], self.model.geom("card_plate").id
        # Few of many contacts are the card's, and each takes longer to look at than all geoms.
        for index in np.flatnonzero((self.data.contact.geom == plate).any(axis=1)).tolist():
            contact = self.data.contact[index]
            mujoco.mj_contactForce(self.model, self.data, index, self._wrench)
            force = contact.frame.reshape(3, 3).T @ self._wrench[:3]
            sign = 1.0 if contact.geom[1] == plate else -1.0
            result.append((contact.pos.copy(), sign * force))
        return result


class Bench(HandBench):
    """One plain slot with the card in the hand; poses are planar, in the slot's frame.

    Args:
        width: Width of the slot [m].
        hand: Hand and its sensor as made; None for the hand as drawn, with an exact sensor.
    """

    def __init__(self, width: float, hand: HandAsMade | None = None) -> None:
        super().__init__(build_bench(width).compile(), hand)
        self.width = width

    def place(self, pose: FloatArray, command: FloatArray | None = None) -> None:
        """Put the card at a pose (3,) [m, m, rad], at rest, and begin anew.

        Args:
            pose: Pose of the card.
            command: Pose that the hand is commanded to; None for the same.
        """
        self.put(in_space(pose), None if command is None else in_space(command))

    def command(self, pose: FloatArray) -> None:
        """Let the next step take the hand to a pose: (3,) [m, m, rad]."""
        self.move(in_space(pose))

    @property
    def pose(self) -> FloatArray:
        """True pose of the card (3,)."""
        body = self.data.body("card")
        return np.array([*body.xpos[:2], math.atan2(body.xmat[3], body.xmat[0])])

    @property
    def sensed(self) -> FloatArray:
        """(3,) what the slot puts on the card as the hand's sensor has it, without noise."""
        return self.felt[_PLANE]

    @property
    def zero(self) -> FloatArray:
        """(3,) what the sensor shows now of a card that touches nothing, without noise."""
        of = self._sensor
        warm = -math.expm1(-self.data.time / of.warm_up)
        return (np.zeros(6) + of.bias + np.asarray(of.drift) * warm)[_PLANE]

    def contact_wrench(self) -> FloatArray:
        """(3,) what the contacts truly put on the card, card's frame."""
        total, pose = np.zeros(3), self.pose
        for point, force in self._contacts():
            x, y = point[:2] - pose[:2]
            total += [*(turn(pose[2]).T @ force[:2]), x * force[1] - y * force[0]]
        return total

    def touched(self) -> list[FloatArray]:
        """Return where contacts press on the card, (2,) each, card's frame [m]."""
        pose = self.pose
        return [turn(pose[2]).T @ (point[:2] - pose[:2]) for point, _ in self._contacts()]

    def true_state(self) -> tuple[int, int]:
        """Return state and side by MuJoCo's contacts; (0, 0) if they are none of the six."""
        found = [(point[:2], np.linalg.norm(force[:2])) for point, force in self._contacts()]
        least = LEAST_SHARE * max((force for _, force in found), default=0.0)
        pairs = {
            (self._touch(point), 1 if point[0] > 0.0 else -1)
            for point, force in found
            if force >= least
        }
        return _NAMED.get(frozenset(pairs), (0, 0))

    def _touch(self, point: FloatArray) -> Touch | None:
        """Return which features meet at a point of the slot's frame; None where it is unclear."""
        pose = self.pose
        own = turn(pose[2]).T @ (point - pose[:2])
        half_card, half_slot = CARD_AND_SLOT.card_width / 2.0, self.width / 2.0
        beside, behind = abs(abs(own[0]) - half_card) < NEAR, abs(own[1]) < NEAR
        at_mouth = np.hypot(abs(point[0]) - half_slot, point[1]) < NEAR
        if at_mouth == (beside and behind):
            return None
        if at_mouth:
            return Touch.EDGE if behind else Touch.SIDE if beside else None
        return Touch.FACE if abs(point[1]) < NEAR else Touch.WALL


def in_space(pose: FloatArray) -> FloatArray:
    """Return a planar pose (3,) [m, m, rad] as one of six directions."""
    result = np.zeros(_HAND)
    result[_PLANE] = pose
    return result


def press(bench: Bench, pose: FloatArray, wrench: FloatArray, seconds: float = 0.25) -> None:
    """Hold the card at a pose so that the hand's springs balance a wrench.

    Args:
        bench: Bench to set anew.
        pose: (3,) pose of the card [m, m, rad].
        wrench: (3,) wrench by the slot on the card, card's frame [N, N, N m].
        seconds: Time to come to rest [s].
    """
    load = np.array([*(turn(pose[2]) @ wrench[:2]), wrench[2]])
    bench.place(pose, pose - load / bench.stiffness[_PLANE])
    bench.step(seconds)
