"""A rover of ours as any robot: drawn in files, moved by its boards, and identified from its log.

Nobody is told how it was made. The motion is designed for its drawing with servos in place of its
boards' loops; it is identified by the duty that its boards applied.
"""

import contextlib
import dataclasses
import io
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

from controllers.identification.any_model.motion import Series, largest
from experiments.own.excite import best_shape
from experiments.own.excite import sensors as sensors_of
from experiments.own.excite_options import Options as ExciteOptions
from experiments.own.hidden.results import RobotResult, RobotTrial, found_in
from experiments.own.identification import identify
from experiments.own.identify_options import STEP
from experiments.own.motion_file import write_motion
from experiments.own.play import run as play
from experiments.own.play_options import Options as PlayOptions
from experiments.own.replay import replay_own
from models.compose import ARM_JOINTS, WHEELS, RobotPlacement, build_scene
from models.configuration import FLAT
from models.datasheets import POWER_STAGE
from perception.geometry.arrays import FloatArray
from twin.hardware.emulator.amplifier import (
    AmplifierConfig,
    bridge_share,
    command_volts,
    pulse_share,
)
from twin.logs.mapping import read_log, read_mapping
from twin.prediction.limits import Limits
from twin.prediction.parameters import Parameter, catalogue, explicit, select
from twin.realism import make_robots

NAME = "rover1"
ARM = tuple(f"{NAME}/{joint}" for joint in ARM_JOINTS)
BANDWIDTH = 3.0
"""Bandwidth of the servos that stand for the boards' loops while a motion is designed [Hz]."""
RATE = 1.5
"""Largest rate of a joint in a motion [rad/s]; gears and rover bear twice as much."""
HIGHEST = 1.0
"""Highest frequency of a motion [Hz]."""
ENCODER, FORCE, MOMENT = 0.003, 0.5, 0.1
"""What measurements may be off by and no parameter explains, as deviations: of the joints, a third
of their gears' play of 0.5 degrees [rad]; of the wrench, 3 % cross-talk of an arm of 1 kg in motion
[N, N m]."""
TOLD_BY_MOTION = (
    *(f"joint.{joint}_joint.friction" for joint in ARM),
    *(f"body.{NAME}/{link}.mass:0.05" for link in ("turret", "upper_arm", "forearm", "wrist")),
    *(f"body.{NAME}/{link}.centre_[yz]:0.006" for link in ("upper_arm", "forearm", "wrist")),
    "sensor.*force.bias*:0.3",
    "sensor.*torque.bias*:0.03",
)
BIASES = tuple(f"sensor.{joint}_joint.position.bias:0.005" for joint in ARM)
"""Errors of the jig by which the arm is homed [rad]."""
RESISTANCES = tuple(f"actuator.{joint}.resistance" for joint in ARM)
PARAMETERS = (*(f"{each}:0.4" for each in RESISTANCES), *TOLD_BY_MOTION, *BIASES, "delay:0.005")
"""What is sought: of winding and bridge, of gears and links; and what the sensors add."""
PERIOD = 0.01
"""Between two commands of the boards' loops [s]."""


@dataclasses.dataclass(frozen=True)
class RoverDesign:
    """A motion to design for the drawing.

    Attributes:
        duration: Its duration [s].
        generations: Generations of the search.
        seed: Seed of the search.
    """

    duration: float
    generations: int
    seed: int


@dataclasses.dataclass(frozen=True)
class RoverResult:
    """What was found of one rover.

    Attributes:
        robot: Its parameters of which the truth is known.
        bits: Bits that differ in the replay of a simulated run.
        board_bits: Bits that differ in that of the run through its boards.
    """

    robot: RobotResult
    bits: int
    board_bits: int


def drawing() -> mujoco.MjSpec:
    """Return the rover as drawn on flat ground, without pictures, which no file holds."""
    spec = build_scene(FLAT, [RobotPlacement(NAME)])
    for item in [*spec.geoms, *spec.sites]:
        item.material = ""
    for item in [*spec.materials, *spec.textures]:
        spec.delete(item)
    return spec


def servo_drawing() -> mujoco.MjSpec:
    """Return that with servos of the arm's joints, braked wheels, and the noise of its sensors."""
    spec = drawing()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    home: list[float] = []
    for joint in ARM:
        hinge = model.joint(f"{joint}_joint")
        place = int(hinge.dofadr[0])
        stiffness = float(inertia[place, place]) * (2.0 * np.pi * BANDWIDTH) ** 2
        spec.actuator(joint).set_to_position(stiffness, dampratio=1.0)
        spec.actuator(joint).ctrlrange = hinge.range
        home.append(float(data.qpos[hinge.qposadr[0]]))
    for wheel in WHEELS:
        spec.delete(spec.actuator(f"{NAME}/{wheel}"))
        spec.joint(f"{NAME}/{wheel}_joint").frictionloss = 1.0
    spec.keys[0].ctrl = home
    noise = {f"{joint}_pos": ENCODER for joint in ARM}
    noise |= {f"{NAME}/arm_base_force": FORCE, f"{NAME}/arm_base_torque": MOMENT}
    for sensor in list(spec.sensors):
        if sensor.name in noise:
            sensor.noise = noise[sensor.name]
        else:
            spec.delete(sensor)
    return spec


def full_voltage() -> float:
    """Return the mean voltage of a motor at full duty, by the drawing of its amplifier [V]."""
    card = AmplifierConfig()
    volts = command_volts([card.full_code], card)
    return card.battery * float(bridge_share(pulse_share(volts, card), card)[0])


def dead_band() -> float:
    """Return the duty below which the bridge passes no pulse on, by that drawing."""
    card = AmplifierConfig()
    return card.least_pulse * card.clock_frequency / card.clock_duty


def mapping_text() -> str:
    """Return the mapping from a log of the rover to its drawing."""
    lines = ["# Duties are shares of the voltage at full duty."]
    for group, names in (("wheels", [f"{NAME}/{wheel}" for wheel in WHEELS]), ("arm", ARM)):
        for index, name in enumerate(names):
            lines += [f'[actuators."{name}"]', f'field = "/{NAME}/{group}.value[{index}]"']
            lines += [
                'unit = "V"',
                f"scale = {full_voltage():.4f}",
                f"dead_band = {dead_band():.4f}",
            ]
    for index, name in enumerate(ARM):
        lines += [f'[sensors."{name}_joint.position"]']
        lines += [f'field = "/{NAME}/arm_angles.value[{index}]"', f"noise = {ENCODER}"]
        lines += ['unit = "rad"']
    wrench = [f"/{NAME}/arm_base_wrench.value[{index}]" for index in range(6)]
    for name, fields, unit, noise in (
        ("force", wrench[:3], "N", FORCE),
        ("torque", wrench[3:], "N m", MOMENT),
    ):
        quoted = ", ".join(f'"{field}"' for field in fields)
        lines += [f'[sensors."{NAME}/arm_base_{name}"]', f"fields = [{quoted}]"]
        lines += [f'unit = "{unit}"', f"noise = {noise}"]
    return "\n".join(lines) + "\n"


def write_files(folder: Path) -> None:
    """Write what the commands excite, identify and replay need: two models, limits, a mapping."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "drawn.xml").write_text(drawing().to_xml())
    (folder / "servo.xml").write_text(servo_drawing().to_xml())
    rates = (f'[joints."{joint}_joint"]\nrate = {RATE}\n' for joint in ARM)
    (folder / "limits.toml").write_text("".join(rates))
    (folder / "mapping.toml").write_text(mapping_text())


def designed(trial: RoverDesign) -> FloatArray:
    """Design a motion for the rover as drawn, and return its shape."""
    spec = servo_drawing()
    model = spec.compile()
    options = ExciteOptions(
        Path("servo.xml"),
        TOLD_BY_MOTION,
        Path("motion.csv"),
        duration=trial.duration,
        highest=HIGHEST,
        period=PERIOD,
        generations=trial.generations,
        seed=trial.seed,
    )
    parameters = select(explicit(spec), TOLD_BY_MOTION, sensors_of(model))
    series, limits = _series(model, trial.duration), _limits(model)
    return best_shape(spec, parameters, series, limits, options, lambda step, best: None)


def _series(model: mujoco.MjModel, duration: float) -> Series:
    return Series(model.key_ctrl[0].copy(), duration, HIGHEST)


def _limits(model: mujoco.MjModel) -> Limits:
    """Return the limits of a motion, as `write_files` writes them."""
    rates = {f"{joint}_joint": RATE for joint in ARM}
    return dataclasses.replace(Limits.of_model(model), rates=rates)


def identified(trial: RobotTrial) -> RoverResult:
    """Let a rover as made play motions through its boards, and identify it from its log.

    Args:
        trial: The rover; its seed is that of the connection too, and of the motion held out.
    """
    model = servo_drawing().compile()
    series, limits = _series(model, trial.duration), _limits(model)
    steps = np.arange(0.0, trial.duration, model.opt.timestep)

    def excess(shape: FloatArray) -> float:
        return limits.excess(model, series.commands(shape, steps))

    unseen = largest(series.random(np.random.default_rng(trial.seed)), excess, 0.1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_files(folder)
        mapping = read_mapping(folder / "mapping.toml")
        for motion, shape in (("seen", np.array(trial.shape)), ("unseen", unseen)):
            stamps = np.arange(0.0, trial.duration, PERIOD)
            write_motion(folder / f"{motion}.csv", ARM, stamps, series.commands(shape, stamps))
            _play(folder, motion, "emulated", trial.seed)
        logs = [read_log(folder / f"{each}.mcap", mapping) for each in ("seen", "unseen")]
        begin = time.process_time()
        result = identify(drawing(), logs[:1], PARAMETERS, logs[1:], "held", STEP)
        seconds = time.process_time() - begin
        board_bits = sum(each.bits for each in replay_own(folder / "seen.mcap"))
        (folder / "seen.mcap").unlink()
        _play(folder, "seen", "sim", trial.seed)
        bits = sum(each.bits for each in replay_own(folder / "seen.mcap"))
    parameters = result.seen.predictor.parameters
    truth = true_coordinates(parameters, trial.seed)
    known = np.flatnonzero(np.isfinite(truth))
    found = found_in(result, np.where(np.isfinite(truth), truth, result.fit.coordinates), seconds)
    found = dataclasses.replace(
        found,
        coordinates=found.coordinates[known],
        covariance=found.covariance[np.ix_(known, known)],
        told=found.told[known],
        plain=found.plain[known],
    )
    names = tuple(parameters[index].name for index in known)
    robot = RobotResult(trial, names, 0, truth[known], (found,), np.zeros(0), 0.0)
    return RoverResult(robot, bits, board_bits)


def _play(folder: Path, motion: str, target: str, seed: int) -> None:
    files = folder / f"{motion}.csv", folder / f"{motion}.mcap"
    with contextlib.redirect_stdout(io.StringIO()):
        status = play(PlayOptions(*files, robot=target, realism="default", seed=seed))
    assert status == 0


def true_coordinates(parameters: list[Parameter], seed: int) -> FloatArray:
    """Return the true coordinates (n,) of parameters; NaN where nobody knows them.

    Args:
        parameters: Parameters of the rover as drawn.
        seed: Seed of the rover as made.
    """
    made = build_scene(FLAT, make_robots([RobotPlacement(NAME)], "default", seed))
    truth = {each.name: each.nominal for each in catalogue(explicit(made), {})}
    for each in RESISTANCES:  # A motor's current flows through two switches of its bridge.
        truth[each] += 2.0 * POWER_STAGE.switch_resistance
    truth.pop("delay", None)
    return np.array(
        [each.coordinate(truth[each.name]) if each.name in truth else np.nan for each in parameters]
    )
