"""Connection to robots by a target named on the command line."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from models.compose import FLAT, FieldConfig, RobotPlacement
from twin.camera import StereoConfig
from twin.clock import Clock, WallClock
from twin.hardware.connect_boards import (
    emulated_robots,
    quantised_robots,
    watched,
    wired_robot,
    without_pauses,
)
from twin.hardware.emulator.modem import ModemConfig, virtual_links
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig, simulate
from twin.hardware.radio.channel import SerialChannel
from twin.hardware.radio.framed_radio import FramedConfig, FramedLink
from twin.hardware.serial_link import SerialLink
from twin.hardware.wiring import Wiring, wirings_of
from twin.link import Link
from twin.optics.realism import IDEAL_CAMERA, RealismName
from twin.realism import Realism, make_robots, realism_of
from twin.robot import Robot
from twin.robot_clock import give_clocks
from twin.servo import SERVO_PERIOD
from twin.simulation import Simulation


@dataclasses.dataclass(frozen=True)
class LineConfig:
    """Simulated lines between hosts and boards, and between the robots.

    Attributes:
        bus_faults: Share of damaged exchanges with emulated motor boards, 0 to 1.
        modems: Properties of the radio's modems; None for those of the realism.
        radio_rng: Random generator for the radio's byte errors and session numbers; None for one
            drawn from the seed.
    """

    bus_faults: float = 0.0
    modems: ModemConfig | None = None
    radio_rng: np.random.Generator | None = None


@dataclasses.dataclass(frozen=True)
class ConnectionSettings:
    """What `connect` was asked for, but for the lines: all that decides what a simulation measures.

    Attributes:
        target: See `connect`.
        robots: See `connect`.
        field: See `connect`.
        realism: See `connect`.
        stereo: See `connect`.
        seed: See `connect`.
    """

    target: str
    robots: tuple[RobotPlacement, ...] = (RobotPlacement(),)
    field: FieldConfig = FLAT
    realism: RealismName | Realism = "ideal"
    stereo: StereoConfig | None = None
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Connection:
    """Robots, the clock that paces them and, for simulated ones, the scene behind them.

    Attributes:
        robots: Robots by name.
        clock: Clock that paces `twin.loop.run`.
        simulation: Scene with the truth, for scoring and recording only; None for real robots.
        emulator: Process behind emulated boards; None for all others.
        links: Ends of the radio by robot name; empty without a radio.
        settings: What was asked for; None for real robots.
        resources: Ports, processes and threads that `close` releases.
    """

    robots: Mapping[str, Robot]
    clock: Clock
    simulation: Simulation | None
    emulator: EmulatorProcess | None = None
    links: Mapping[str, Link] = dataclasses.field(default_factory=dict[str, Link])
    settings: ConnectionSettings | None = None
    resources: contextlib.ExitStack = dataclasses.field(default_factory=contextlib.ExitStack)

    def close(self) -> None:
        """Deactivate the robots and release the scene."""
        with self.resources:
            for robot in self.robots.values():
                robot.deactivate()
            if self.simulation is not None:
                self.simulation.close()

    def __enter__(self) -> "Connection":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(
    target: str = "sim",
    *,
    robots: Sequence[RobotPlacement] = (RobotPlacement(),),
    field: FieldConfig = FLAT,
    realism: RealismName | Realism = "ideal",
    stereo: StereoConfig | None = None,
    seed: int = 0,
    lines: LineConfig | None = None,
) -> Connection:
    """Return robots at rest that wait to be activated.

    Args:
        target: One of `TARGETS`.
        robots: Names and initial poses of simulated and emulated robots.
        field: Ground of a simulated scene.
        realism: How far simulated and emulated robots, their sensors and clocks are from their
            drawings, and what the radio between them loses.
        stereo: Stereo heads of simulated, quantised and emulated robots; None leaves the channel
            missing.
        seed: Random seed of all sensor noise, and of each robot, its sensors and clock as made.
        lines: Simulated radio and damage on emulated lines; None for the default.

    Raises:
        ValueError: If the target or the realism is unknown or misspelt, or a calibration cannot be
            used.
        LinkError: If a port cannot be opened.
        RobotError: If a board does not answer.
    """
    wirings = wirings_of(target)
    if wirings:
        return _connect_wires(wirings)
    settings = ConnectionSettings(target, tuple(robots), field, realism, stereo, seed)
    chosen = realism_of(realism)
    made = make_robots(robots, chosen, seed)
    if stereo is not None and chosen.cameras != IDEAL_CAMERA:
        stereo = dataclasses.replace(stereo, realism=chosen.cameras)
    scene = SceneConfig(made, field, seed, stereo, chosen.sensor_errors)
    lines = lines or LineConfig()
    if target != "sim" and any(robot.model for robot in scene.robots):
        raise ValueError(
            f"{target}: the boards have four wheels and four arm joints each, not more"
        )
    if target == "emulated":
        bare = _connect_emulated(scene, lines.bus_faults)
    elif target == "quantised":
        bare = _connect_quantised(scene)
    else:
        simulation = simulate(scene, chosen.suite)
        bare = Connection(simulation.robots, simulation, simulation)
    radio_rng = lines.radio_rng or np.random.default_rng([seed, 6])
    modems = lines.modems or chosen.modems
    links = virtual_links(list(bare.robots), lambda: bare.clock.time, radio_rng, modems)
    clocked = bare.robots if chosen.clock is None else give_clocks(bare.robots, chosen.clock, seed)
    return dataclasses.replace(bare, robots=clocked, links=links, settings=settings)


def _connect_quantised(config: SceneConfig) -> Connection:
    scene = EmulatedScene(config)
    robots = quantised_robots(scene, config)
    resources = contextlib.ExitStack()
    for robot in robots.values():
        resources.callback(robot.close)
    return Connection(robots, scene, scene.simulation, resources=resources)


def _connect_emulated(config: SceneConfig, bus_faults: float) -> Connection:
    with contextlib.ExitStack() as opening:
        emulator = EmulatorProcess(config, bus_faults)
        opening.callback(emulator.close)
        robots = emulated_robots(emulator, config)
        for robot in robots.values():
            opening.callback(robot.close)
        resources = opening.pop_all()
    return Connection(robots, emulator, None, emulator, resources=resources)


def _connect_wires(wirings: Sequence[Wiring]) -> Connection:
    clock = WallClock(SERVO_PERIOD, wirings[0].slow_down)
    robots: dict[str, Robot] = {}
    links: dict[str, Link] = {}
    with contextlib.ExitStack() as opening:
        for wiring in wirings:
            robot = robots[wiring.robot] = wired_robot(wiring, lambda: clock.time)
            opening.callback(robot.close)
            opening.enter_context(watched(robot))
            if wiring.radio:
                port = SerialLink(wiring.radio, FramedConfig.baud)
                opening.callback(port.close)
                # A session number of before must not be drawn again.
                rng = np.random.default_rng()
                links[wiring.robot] = FramedLink(SerialChannel(port, lambda: clock.time), rng)
        opening.enter_context(without_pauses())
        resources = opening.pop_all()
    return Connection(robots, clock, None, links=links, resources=resources)
