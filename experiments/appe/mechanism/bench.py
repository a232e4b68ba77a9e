"""BRAID's mechanism, simulated: put into a word, driven to another, measured."""

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.braid.arm.chain import chain_pose
from controllers.braid.arm.stage import RADIAL, StageGeometry, rim_joints, stage_pose
from controllers.braid.bus.drive import WireDrive, word_bits
from models.braid.build import BENCH, BraidConfig, build_bench
from models.datasheets import BRAID, MUSCLE_WIRE
from perception.geometry.arrays import FloatArray, IntArray

GEOMETRY = StageGeometry(BRAID.radius, BRAID.short, BRAID.long)
TICK = 0.01
"""Time between two settings of the wires' currents [s]."""


class BraidBench:
    """A model with BRAID in it, and the addresses of its parts in the model's arrays.

    Attributes:
        model: Compiled model of the scene.
        data: State of the scene.
        stages: Number of stages.
        wires: (n, 3, 2) indices of the actuators, extending and retracting.
    """

    def __init__(self, model: mujoco.MjModel, stages: int, prefix: str = BENCH) -> None:
        """Find the parts; the arm is in the key frame ``home``.

        Args:
            model: Compiled scene of `models.braid.build`.
            stages: Number of stages.
            prefix: Prefix of BRAID's names.
        """
        self.model, self.stages, self._prefix = model, stages, prefix
        self.data = mujoco.MjData(model)
        names = [[f"{prefix}stage{k}_leg{j}" for j in (1, 2, 3)] for k in range(1, stages + 1)]
        self._slides = np.array(
            [[model.joint(f"{leg}_joint").qposadr[0] for leg in row] for row in names]
        )
        self._hinges = np.array(
            [[model.joint(f"{leg}_hinge_joint").qposadr[0] for leg in row] for row in names]
        )
        self._platforms = np.array(
            [model.joint(f"{prefix}stage{k}_x_joint").qposadr[0] for k in range(1, stages + 1)]
        )
        self.wires = np.array(
            [
                [
                    [model.actuator(f"{leg}_{end}").id for end in ("extend", "retract")]
                    for leg in row
                ]
                for row in names
            ]
        )
        mujoco.mj_resetDataKeyframe(model, self.data, model.key("home").id)
        mujoco.mj_forward(model, self.data)

    def put(self, word: IntArray) -> None:
        """Put the arm at rest into a word (n,), exactly by its kinematics, wires cold and off."""
        lengths = np.where(word_bits(word), GEOMETRY.long, GEOMETRY.short)
        joints = rim_joints(GEOMETRY.radius)
        for stage, pose in enumerate(stage_pose(lengths, GEOMETRY.radius)):
            position, rotation = pose[:3], pose[3:].reshape(3, 3)
            at = self._platforms[stage]
            self.data.qpos[at : at + 3] = position - [0.0, 0.0, BRAID.middle]
            mujoco.mju_mat2Quat(self.data.qpos[at + 3 : at + 7], pose[3:])
            feet = (joints - position) @ rotation  # in the platform's frame
            down = feet - joints
            # The hinge turns about the rim's tangent, so that it leads -z towards -radial.
            inward = np.sum(down[:, :2] * RADIAL, axis=1)
            self.data.qpos[self._hinges[stage]] = np.arctan2(-inward, -down[:, 2])
        self.data.qpos[self._slides] = lengths - BRAID.middle
        self.data.qvel[:] = 0.0
        self.data.act[self.model.actuator_actadr[self.wires]] = 0.0
        self.data.ctrl[self.wires] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def bits(self) -> NDArray[np.bool_]:
        """Return (n, 3) which legs are longer than in their middle."""
        return self.travel() > 0.0

    def travel(self) -> FloatArray:
        """Return (n, 3) the travel of each leg from its middle [m]."""
        return self.data.qpos[self._slides]

    def loads(self) -> FloatArray:
        """Return (n, 3) the load on each detent at rest, over its barrier.

        Positive where it pulls towards the barrier; at 1 the leg goes over.
        """
        at = self.travel()
        force = BRAID.detent * at * (1.0 - (at / BRAID.half_stroke) ** 2)
        return force * np.sign(at) / BRAID.barrier

    def tip(self) -> FloatArray:
        """Return the last platform's pose (12,) in the base's frame."""
        base, tip = (self.data.site(f"{self._prefix}{name}") for name in ("braid_base", "tip"))
        turn = base.xmat.reshape(3, 3)
        position = turn.T @ (tip.xpos - base.xpos)
        return np.concatenate([position, (turn.T @ tip.xmat.reshape(3, 3)).ravel()])

    def step(self, seconds: float) -> None:
        """Simulate with the controls as they are."""
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.model.opt.timestep))

    def heat(self, levels: FloatArray) -> None:
        """Give the bundles (n, 3, 2) fractions of the rated current."""
        self.data.ctrl[self.wires] = levels * MUSCLE_WIRE.heating

    def ticks(self, drive: WireDrive) -> Iterator[float]:
        """Carry out the change of word that a drive has begun, and yield the time after each tick.

        Yields:
            Time since the change began [s].
        """
        for tick in range(round(drive.duration / TICK)):
            self.heat(drive.levels((tick + 0.5) * TICK))
            self.step(TICK)
            yield (tick + 1) * TICK

    def drive(self, drive: WireDrive) -> None:
        """Carry out the change of word that a drive has begun."""
        for _ in self.ticks(drive):
            pass

    def warnings(self) -> int:
        """Return how many warnings MuJoCo gave."""
        return int(sum(warning.number for warning in self.data.warning))


def make_bench(config: BraidConfig, gravity: bool = True) -> BraidBench:
    """Return BRAID alone on a table."""
    return BraidBench(build_bench(config, gravity).compile(), config.stages)


def ideal_tip(word: IntArray) -> FloatArray:
    """Return the tip's pose (12,) of a word (n,) by the exact kinematics."""
    lengths = np.where(word_bits(word), GEOMETRY.long, GEOMETRY.short)
    return chain_pose(stage_pose(lengths, GEOMETRY.radius)[None])[0]
