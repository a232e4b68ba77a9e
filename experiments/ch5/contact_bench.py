"""The bench of ch5-contact: a card on a compliant hand at a slot, and what truly touches."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.insertion.contact import CardInSlot, Touch, turn
from models.card_and_slot.build import compile_bench
from models.datasheets import CARD_AND_SLOT, HAND

Floats = NDArray[np.float64]

NEAR = 5e-4
"""Distance within which a contact is at a corner [m]; the solver's overlap stays below 0.1 mm."""
LEAST_SHARE = 0.05
"""A contact with less of the largest force does not count."""

_STATES: dict[frozenset[tuple[Touch, int]], tuple[int, int]] = {
    frozenset({(Touch.EDGE, s)}): (1, s) for s in (-1, 1)
}
for _s in (-1, 1):
    _STATES[frozenset({(Touch.SIDE, _s)})] = (2, _s)
    _STATES[frozenset({(Touch.FACE, _s)})] = (3, _s)
    _STATES[frozenset({(Touch.EDGE, _s), (Touch.SIDE, -_s)})] = (4, _s)
    _STATES[frozenset({(Touch.WALL, _s), (Touch.SIDE, -_s)})] = (5, _s)
    _STATES[frozenset({(Touch.WALL, _s)})] = (6, _s)


def shape_of(width: float) -> CardInSlot:
    """Return card and slot as the CAD has them, for a slot width [m]."""
    sheet = CARD_AND_SLOT
    return CardInSlot(
        sheet.card_width, sheet.card_length, width, sheet.slot_depth, sheet.wall, sheet.friction
    )


class Bench:
    """One slot with the card in the hand; poses are planar, in the slot's frame."""

    def __init__(self, width: float) -> None:
        """Build it with a slot of the given width [m]."""
        self.width = width
        self.model = compile_bench(width)
        self.data = mujoco.MjData(self.model)
        self._wrench = np.zeros(6)

    def command(self, pose: Floats) -> None:
        """Move the hand's carrier: (3,) [m, m, rad]."""
        self.data.mocap_pos[0] = [pose[0], pose[1], 0.0]
        half = pose[2] / 2.0
        self.data.mocap_quat[0] = [math.cos(half), 0.0, 0.0, math.sin(half)]

    def step(self, seconds: float) -> float:
        """Go on for a time [s] and return the largest contact force on the way [N]."""
        largest = 0.0
        for _ in range(max(1, round(seconds / self.model.opt.timestep))):
            mujoco.mj_step(self.model, self.data)
            if self.data.ncon:
                force = self.contact_wrench()
                largest = max(largest, math.hypot(force[0], force[1]))
        return largest

    @property
    def pose(self) -> Floats:
        """True pose of the card (3,)."""
        body = self.data.body("card")
        matrix = body.xmat
        return np.array([body.xpos[0], body.xpos[1], math.atan2(matrix[3], matrix[0])])

    @property
    def sensed(self) -> Floats:
        """(3,) what the slot puts on the card as the hand's sensor has it, without noise."""
        values = self.data.sensordata
        return -np.array([values[0], values[1], values[5]])

    def contact_wrench(self) -> Floats:
        """(3,) what the contacts truly put on the card, card's frame."""
        total = np.zeros(3)
        pose = self.pose
        rotation = turn(pose[2])
        for point, force in self._contacts():
            lever = point - pose[:2]
            moment = lever[0] * force[1] - lever[1] * force[0]
            total += [*(rotation.T @ force), moment]
        return total

    def touched(self) -> list[Floats]:
        """Return where contacts press on the card, (2,) each, card's frame [m]."""
        pose = self.pose
        return [turn(pose[2]).T @ (point - pose[:2]) for point, _ in self._contacts()]

    def true_state(self) -> tuple[int, int]:
        """Return state and side by MuJoCo's contacts; (0, 0) if they are none of the six."""
        found = list(self._contacts())
        if not found:
            return 0, 0
        largest = max(np.linalg.norm(force) for _, force in found)
        pairs: set[tuple[Touch, int]] = set()
        for point, force in found:
            if np.linalg.norm(force) < LEAST_SHARE * largest:
                continue
            touch = self._touch(point)
            if touch is None:
                return 0, 0
            pairs.add((touch, 1 if point[0] > 0.0 else -1))
        return _STATES.get(frozenset(pairs), (0, 0))

    def _touch(self, point: Floats) -> Touch | None:
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

    def _contacts(self) -> list[tuple[Floats, Floats]]:
        """Points and forces on the card, (2,) each, slot's frame."""
        result = []
        plate = self.model.geom("card_plate").id
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            mujoco.mj_contactForce(self.model, self.data, index, self._wrench)
            force = contact.frame.reshape(3, 3).T @ self._wrench[:3]
            sign = 1.0 if contact.geom[1] == plate else -1.0
            result.append((contact.pos[:2].copy(), sign * force[:2]))
        return result


def press(bench: Bench, pose: Floats, wrench: Floats, seconds: float = 0.25) -> None:
    """Hold the card at a pose so that the hand's springs balance a wrench.

    Args:
        bench: Is set anew.
        pose: (3,) of the card.
        wrench: (3,) that the slot shall put on the card, card's frame.
        seconds: To come to rest [s].
    """
    force = turn(pose[2]) @ wrench[:2]
    offset = np.array([*(-force / HAND.stiffness), -wrench[2] / HAND.turn_stiffness])
    mujoco.mj_resetData(bench.model, bench.data)
    command = pose + offset
    bench.command(command)
    # The hand's joints turn with the carrier.
    bench.data.qpos[:2] = turn(command[2]).T @ (pose[:2] - command[:2])
    bench.data.qpos[5] = pose[2] - command[2]
    bench.step(seconds)
