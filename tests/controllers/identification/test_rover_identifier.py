"""Which excitation the identifier swings in each window, and what it compares with rest."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from controllers.identification.arm_motion import CONSTANT, Excitation
from controllers.identification.rover_identifier import (
    ROVER_ARM_LIMITS,
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from models.compose import FLAT, RobotPlacement, make_model
from twin.describe import describe_rover
from twin.robot import Channel, Observation, Validity

ROBOT = "rover1"
ARM = SwingingArm(0.56, 0.0107, (0.31, 0.015), (0.0, 0.06))
PLANNED = Excitation(0.7, 0.3, 5.0)
REST = np.array([0.1, -0.2, 10.0, 3.0, 0.0, 0.0])


def swing(excitation: str, monkeypatch: pytest.MonkeyPatch) -> RoverIdentifier:
    """Let an identifier swing for three windows of 0.4 s, with its plans and fits replaced."""
    config = RoverIdentifierConfig(ROBOT, ARM, excitation)
    identifier = RoverIdentifier(config, np.random.default_rng(0))
    monkeypatch.setattr(identifier, "_plan", lambda: PLANNED)
    monkeypatch.setattr(identifier, "_data", lambda: None)
    monkeypatch.setattr(identifier.fit, "fit", lambda data, iterations=30: None)
    swing_through(identifier)
    return identifier


def swing_through(identifier: RoverIdentifier) -> None:
    """Step an identifier through three windows of 0.4 s."""
    config = identifier.config
    period = config.sensors.period
    for tick in range(round((config.approach + config.rest + 1.2) / period)):
        time = tick * period
        rests = time < config.approach + config.rest - 0.5 * period
        pushed = REST + (0.0 if rests else 1.0)
        seen = Observation(
            time,
            arm_angles=Channel(np.zeros(4), time, Validity.MEASURED),
            arm_base_wrench=Channel(pushed, time, Validity.MEASURED),
            inclinometer=Channel(np.array([0.02, 0.0]) + (not rests), time, Validity.MEASURED),
        )
        identifier.step({ROBOT: seen})


@pytest.mark.parametrize(
    ("excitation", "expected"),
    [("constant", [CONSTANT] * 3), ("information", [PLANNED] * 3), ("d_optimal", [PLANNED] * 3)],
)
def test_excitation_is_planned_by_a_criterion_and_else_constant(
    monkeypatch: pytest.MonkeyPatch, excitation: str, expected: list[Excitation]
) -> None:
    identifier = swing(excitation, monkeypatch)
    assert identifier.log.excitations == expected
    assert len(identifier.log.estimates) == 3


def test_random_excitation_differs_from_window_to_window(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = swing("random", monkeypatch).log.excitations
    assert len(set(drawn)) == 3 and PLANNED not in drawn and CONSTANT not in drawn


def test_readings_are_deviations_from_those_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    log = swing("constant", monkeypatch).log
    np.testing.assert_allclose(log.wrench, 1.0)
    np.testing.assert_allclose(log.tilt, 1.0)
    assert log.tilt_indices == list(range(len(log.times)))


COLD = """
import numba.core.event as events, numpy as np
from tests.controllers.identification import test_rover_identifier as rehearsed

class Compiled(events.Listener):
    names = []
    def on_start(self, event): self.names.append(event.data["dispatcher"].__name__)
    def on_end(self, event): pass

events.register("numba:compile", Compiled())
identifier = rehearsed.RoverIdentifier(
    rehearsed.RoverIdentifierConfig(rehearsed.ROBOT, rehearsed.ARM), np.random.default_rng(0)
)
print(len(Compiled.names))
rehearsed.swing_through(identifier)
print(len(Compiled.names), len(identifier.log.estimates))
"""


@pytest.mark.slow
def test_no_step_waits_for_a_compiler(tmp_path: Path) -> None:
    """A robot stops when no command comes for 0.15 s."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    ran = subprocess.run(
        [sys.executable, "-c", COLD], env=environment, capture_output=True, text=True, check=True
    )
    built, after, estimates = map(int, ran.stdout.split())
    assert built == after > 0 and estimates == 3


def test_repeated_identification_forgets_all_and_is_gentler_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    identifier = swing("random", monkeypatch)
    assert identifier.log.times and not identifier.done
    gentle = dataclasses.replace(
        ROVER_ARM_LIMITS, acceleration=pytest.approx(0.6 * ROVER_ARM_LIMITS.acceleration)
    )
    assert identifier.repeat()
    assert identifier.config.limits == gentle and not identifier.log.times
    monkeypatch.setattr(identifier, "_data", lambda: None)
    monkeypatch.setattr(identifier.fit, "fit", lambda data, iterations=30: None)
    swing_through(identifier)
    assert len(identifier.log.times) == 120 and len(identifier.log.excitations) == 3
    assert not identifier.repeat() and identifier.config.limits == gentle
    assert len(identifier.log.times) == 120


def test_swinging_arm_is_that_of_the_compiled_model():
    """Masses, centres and inertias of all bodies beyond the shoulder, as MuJoCo has them."""
    model = make_model(FLAT, [RobotPlacement("rover1")])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    shoulder = model.body("rover1/upper_arm").id
    bodies = [shoulder]
    for body in range(shoulder + 1, model.nbody):
        if model.body_parentid[body] in bodies:
            bodies.append(body)
    rotation, pivot = data.body("rover1/chassis").xmat.reshape(3, 3), data.xpos[shoulder]
    masses, centres = model.body_mass[bodies], (data.xipos[bodies] - pivot) @ rotation
    centre = masses @ centres / masses.sum()
    axes = rotation.T @ data.ximat[bodies].reshape(-1, 3, 3)
    inertia = np.einsum("nj,nj->", axes[:, 0] ** 2, model.body_inertia[bodies])
    inertia += masses @ np.sum((centres - centre)[:, 1:] ** 2, axis=1)
    arm = SwingingArm.of(describe_rover("rover1"))
    assert arm.mass == pytest.approx(masses.sum())
    assert arm.inertia == pytest.approx(inertia)
    np.testing.assert_allclose(arm.centre, centre[1:], atol=1e-9)
    mount = (pivot - data.site("rover1/arm_base").xpos) @ rotation
    np.testing.assert_allclose(arm.shoulder, mount[1:], atol=1e-9)


def test_robot_without_an_arm_cannot_swing_it():
    with pytest.raises(ValueError, match="robot 'rover1' has no arm to swing"):
        SwingingArm.of(dataclasses.replace(describe_rover("rover1"), arm=None))
