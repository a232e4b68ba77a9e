"""Scenes that several test files share; compiled once."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import pytest

from models.compose import RobotPlacement
from tests.models.scenes import Scene, make_scene


@pytest.fixture(scope="session")
def rover() -> Scene:
    """One rover with its arm on flat ground."""
    return make_scene(RobotPlacement())


@pytest.fixture(scope="session")
def bare() -> Scene:
    """One rover without arm on flat ground."""
    return make_scene(RobotPlacement(arm=False))
