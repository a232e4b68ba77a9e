"""The scene of ``appa-truss`` at rest, and what is true in it."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.kinematics.arm_inverse import GripperInverse
from controllers.kinematics.serial_chain import SerialChain
from models import datasheets
from models.compose import ARM_JOINTS
from models.truss import MASTER, SLAVE, TRUSS, make_truss, settle_truss
from perception.geometry.arrays import FloatArray
from twin.describe import describe_rover

ROBOTS = (MASTER, SLAVE)
LIFT = 0.07
"""Height of the chord above its seated height at the start [m]."""


def start_angles(height: float) -> FloatArray:
    """Return (4,) the joints that bring the gripper to the segment's end at a height [m].

    Raises:
        ValueError: If the arm cannot reach it.
    """
    arm = SerialChain.of_robot(describe_rover(MASTER))
    inverse = GripperInverse(arm, [0.0, datasheets.ARM.wrist_length, 0.0])
    task = [0.0, TRUSS.reach, height - datasheets.ROVER.centre_height, TRUSS.grip_pitch]
    found = inverse.solutions(task, near=datasheets.ARM.home)
    if len(found) == 0:
        raise ValueError(f"truss: the arm does not reach {TRUSS.reach} m ahead at {height} m")
    return found[0]


class TrussBench:
    """The scene, and what is true in it."""

    def __init__(self, offset: float, tilt: float) -> None:
        """Build it, at rest with the segment held.

        Args:
            offset: Offset of the stage along s [m].
            tilt: Tilt of the stage, in the plan frame [rad].
        """
        height = TRUSS.seated_height + LIFT
        self.model = make_truss(height, start_angles(height), offset, tilt)
        self.data = settle_truss(self.model)
        self._joints = [
            [self.model.joint(f"{name}/{joint}_joint").qposadr[0] for joint in ARM_JOINTS]
            for name in ROBOTS
        ]
        self._motors = [
            [self.model.actuator(f"{name}/{joint}").id for joint in ARM_JOINTS] for name in ROBOTS
        ]
        self._welds = [self.model.equality(f"grip_{name}").id for name in ROBOTS]
        self._now = mujoco.MjData(self.model)
        stage = self.model.body("stage").id
        self._stage = set(np.flatnonzero(self.model.geom_bodyid == stage).tolist())

    def look(self) -> None:
        """Compute this instant's forces on a copy of the state: the simulation is amid a step."""
        now = self._now
        for name in ("qpos", "qvel", "act", "ctrl", "qacc_warmstart"):
            getattr(now, name)[:] = getattr(self.data, name)
        mujoco.mj_forward(self.model, now)

    def place(self, body: str) -> FloatArray:
        """Return (3,) true s, z and angle of a body in the plan frame."""
        seen = self.data.body(body)
        sign = math.copysign(1.0, seen.xmat[4])  # of what looks along s, or against it
        return np.array([*seen.xpos[1:], math.atan2(sign * seen.xmat[7], abs(seen.xmat[4]))])

    def depth(self) -> float:
        """Return how far the leading edge's shallower corner is below the mouth [m]."""
        stage, segment = self.data.body("stage"), self.data.body("segment")
        edge = segment.xmat.reshape(3, 3)[:, 1] * TRUSS.web_width / 2.0
        up = stage.xmat.reshape(3, 3)[:, 2]
        return -float(up @ (segment.xpos - stage.xpos) + abs(up @ edge))

    def grips(self) -> FloatArray:
        """Return (2, 3) the true wrenches of master's and slave's gripper on the segment."""
        data, wrenches = self._now, np.zeros((2, 3))
        equal = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        for index, weld in enumerate(self._welds):
            rows = np.flatnonzero(equal & (data.efc_id == weld))
            if len(rows) == 6:
                force = -data.efc_force[rows]
                wrenches[index] = force[1], force[2], self._moment(index, rows)
        return wrenches

    def _moment(self, index: int, rows: NDArray[np.intp]) -> float:
        """Return the moment about x of a weld's rotational rows on the segment [N m]."""
        address = self.model.joint("segment_joint").dofadr[0]
        dense = np.zeros((self._now.nefc, self.model.nv))
        if mujoco.mj_isSparse(self.model):
            mujoco.mju_sparse2dense(
                dense, self._now.efc_J, self._now.efc_J_rownnz, self._now.efc_J_rowadr,
                self._now.efc_J_colind,
            )  # fmt: skip
        else:
            dense[:] = self._now.efc_J.reshape(dense.shape)
        turns = rows[3:]
        local = dense[turns, address + 3 : address + 6].T @ self._now.efc_force[turns]
        return float((self._now.body("segment").xmat.reshape(3, 3) @ local)[0])

    def contact(self) -> FloatArray:
        """Return (2,) the true force of the stage on the segment along s and z [N]."""
        total, wrench = np.zeros(3), np.zeros(6)
        for index in range(self._now.ncon):
            contact = self._now.contact[index]
            pair = {int(contact.geom[0]), int(contact.geom[1])}
            if not pair & self._stage:
                continue
            mujoco.mj_contactForce(self.model, self._now, index, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += force if int(contact.geom[0]) in self._stage else -force
        return total[1:]

    def joints(self) -> FloatArray:
        """Return (2, 4) the true angles of both arms [rad]."""
        return self.data.qpos[self._joints]

    def efforts(self) -> FloatArray:
        """Return (2, 4) what both arms' motors truly give, before friction [N m]."""
        return self._now.actuator_force[self._motors]

    def base_wrenches(self) -> FloatArray:
        """Return (2, 3) the true wrench of each rover on its arm, in the plan's sense."""
        found: list[list[float]] = []
        for name, facing in zip(ROBOTS, (1, -1), strict=True):
            force = self._now.sensor(f"{name}/arm_base_force").data
            moment = self._now.sensor(f"{name}/arm_base_torque").data
            found.append([facing * force[1], force[2], facing * moment[0]])
        return np.array(found)
