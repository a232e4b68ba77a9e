import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from models.compose import FLAT, ROUGH, RobotPlacement, make_model
from models.datasheets import ARM
from tests.twin.scene import SERVO, compile_scene
from twin.camera import StereoConfig
from twin.clock import SimClock
from twin.connect import connect
from twin.loop import run
from twin.record import Recorder
from twin.robot import ArmMode, Command, WheelMode
from twin.scene_mesh import body_mesh, geom_colour
from twin.screenshot import screenshot
from twin.sensors import DATASHEET
from twin.simulation import Simulation

ROOT = Path(__file__).parent.parent.parent


class Drive:
    """Drives slowly, and looks at the ground ahead."""

    arm = np.array(ARM.home) + [0.0, 0.4, -0.4, -0.8]

    def __init__(self, recorder=None):
        self.recorder = recorder

    def reset(self):
        pass

    def step(self, observations):
        if self.recorder is not None:
            now = observations["rover1"].time
            self.recorder.log_scalars("excitation/omega", [now, 2 * now], ["x", "y"])
            self.recorder.log_band("estimates/mass", 3.0, 2.0, 4.0, ["mass"])
        return {
            "rover1": Command(np.full(4, 1.0), self.arm, WheelMode.SPEED, ArmMode.POSITION)
        }


def small(stereo=None):
    return Simulation(
        compile_scene(), ["rover1"], suite=DATASHEET, servo=SERVO, stereo=stereo, seed=1
    )


def columns(path):
    """Per entity, the number of rows and the values of each component over the recording."""
    rows: dict[str, dict[str, list]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        entity = rows.setdefault(str(chunk.entity_path), {})
        for name in batch.schema.names:
            entity.setdefault(name, []).extend(batch.column(name).to_pylist())
    return rows
