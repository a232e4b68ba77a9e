"""Scenes that can be looked at: our own by name, any other by its file."""

from collections.abc import Callable, Mapping
from pathlib import Path

import mujoco
import numpy as np

from experiments.harness.contract import OptionError
from experiments.mission.scene import draw_scene
from models.braid.build import BraidConfig, build_bench
from models.card_and_slot.guides import width_of
from models.compose import ROUGH, RobotPlacement, make_model
from models.datasheets import CARD_GUIDE


def _rover(seed: int) -> mujoco.MjModel:
    return make_model(ROUGH, [RobotPlacement()])


def _mission(seed: int) -> mujoco.MjModel:
    scene = draw_scene(width_of(CARD_GUIDE.clearances[1]), np.random.default_rng(seed))
    return make_model(scene.field, scene.robots)


def _braid(seed: int) -> mujoco.MjModel:
    return build_bench(BraidConfig()).compile()


_OWN: Mapping[str, Callable[[int], mujoco.MjModel]] = {
    "rover": _rover,
    "mission": _mission,
    "braid": _braid,
}


def model_of(subject: str, seed: int) -> mujoco.MjModel:
    """Return the compiled model of what is to be looked at.

    Args:
        subject: ``rover``, ``mission``, ``braid``, or a file that MuJoCo reads.
        seed: Seed of what is drawn.

    Raises:
        OptionError: If there is no such scene, or MuJoCo cannot read the file.
    """
    if subject in _OWN:
        return _OWN[subject](seed)
    if not Path(subject).is_file():
        raise OptionError(f"view: no scene and no file {subject!r}; scenes: {', '.join(_OWN)}")
    try:
        return mujoco.MjModel.from_xml_path(subject)
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise OptionError(f"view: MuJoCo does not read {subject} ({reason})") from error
