"""``python -m twin.hardware.emulator``: boards to connect to, with the physics behind them.

Without ``--realtime`` the physics stand still until a line on the standard input says
``{"do": "tick"}``, or ``{"do": "run"}`` for time that passes by itself from then on. Time passes
out of band, never by a command on the bus, which a retry would repeat. Every line is answered by
one line; one that is no order changes nothing.
"""

import contextlib
import dataclasses
import functools
import json
import os
import select
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TextIO, cast

import mujoco
import numpy as np
import tyro

from models.compose import RobotPlacement
from perception.geometry.arrays import FloatArray
from perception.geometry.files import MODEL, SETTINGS, check_size, read_json
from twin.camera import StereoConfig
from twin.hardware.background import end_with_parent
from twin.hardware.emulator.drawing import DrawingProcess
from twin.hardware.emulator.faults import FaultEntry, LineFaultConfig
from twin.hardware.emulator.messages import (
    PoseTable,
    Refusal,
    RobotTruth,
    SceneTime,
    Started,
)
from twin.hardware.emulator.modem import ModemConfig, pty_modems
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.emulator.rig import EmulatedRig
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig

LONGEST_ORDER = 4096
"""Longest line on the control line [bytes]."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Emulated boards of rovers on pseudo-terminals and loopback UDP.

    Attributes:
        robots: Names of the rovers; each needs a file in calibration/.
        realtime: Let the physics run on the wall clock at 100 Hz, and two robots' radio with them.
        slow_down: Wall-clock time over the robots' time, with --realtime; the host needs the same
            value, as slow_down=N behind serial:PORT.
        seed: Random seed of all noise and damage.
        line_faults: Share of the exchanges with the motor boards that are damaged, 0 to 1.
        faults: File with scheduled faults: a JSON list of {"robot", "time" [s], "kind",
            "duration" [s], "address"}.
        scene: JSON of a `SceneConfig`, for programs; overrides robots and seed.
        state: File of a state of the physics to begin with, as `numpy.save` writes
            `SavedRun.physics` of the same scene.
        parent: Process that started this one and whose death ends it, for programs; 0 for none.
        frames: Folder for the rovers' stereo pairs, which `serial:` reads as
            stereo=FOLDER/ROBOT.frames. With --realtime they are drawn by a process of their own.
    """

    robots: tuple[str, ...] = ("rover1",)
    realtime: bool = False
    slow_down: float = 1.0
    seed: int = 0
    line_faults: float = 0.0
    faults: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    scene: Annotated[str, tyro.conf.arg(metavar="JSON")] = ""
    state: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    parent: int = 0
    frames: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None


class Emulator:
    """Scene, rigs and the loop that serves them."""

    def __init__(
        self,
        scene: SceneConfig,
        line_faults: float,
        faults: Sequence[object],
        frames: Path | None = None,
        state: FloatArray | None = None,
    ) -> None:
        """Build the scene and power the boards on.

        Args:
            scene: Robots, ground and cameras.
            line_faults: Share of damaged exchanges.
            faults: Scheduled faults, each as `FaultEntry`.
            frames: Folder for stereo pairs; None for none.
            state: State of the physics to begin with; None for the scene at rest.

        Raises:
            ValueError: If the state is of another scene, a fault is malformed, or it names an
                unknown robot, board or kind.
            CalibrationError: If a robot's calibration cannot be used.
        """
        self._drawing: DrawingProcess | None = None
        self.scene = EmulatedScene(scene)
        if state is not None:
            self.scene.begin_at(state)
        names = list(self.scene.rovers)
        schedule = [FaultEntry.parse(entry) for entry in faults]
        for entry in schedule:
            if entry.robot not in ("", *names):
                raise ValueError(f"fault of robot {entry.robot!r}: there are {', '.join(names)}")
        config = LineFaultConfig(line_faults)
        sources = np.random.default_rng([scene.seed, 5]).spawn(len(names))
        self.rigs: dict[str, EmulatedRig] = {}
        for (name, rover), source in zip(self.scene.rovers.items(), sources, strict=True):
            own = [entry.fault() for entry in schedule if entry.robot in ("", name)]
            self.rigs[name] = EmulatedRig(rover, config, own, source, frames)
        self._ports: list[PseudoTerminal | socket.socket | TextIO] = [
            port for rig in self.rigs.values() for port in (rig.bus, rig.analogue, rig.wrench)
        ]
        self.runs = False
        self._heard = b""  # Of a line that is not over yet.
        self._overlong = False

    def draw_apart(self) -> None:
        """Have stereo pairs drawn in a process of their own from now on."""
        heads = self.scene.simulation.heads
        self._drawing = DrawingProcess(heads)
        for name in heads:
            self.rigs[name].newest = functools.partial(self._drawing.newest, name)

    def listen(self) -> None:
        """Obey the orders on the standard input from now on."""
        self._ports.append(sys.stdin)

    def tick(self) -> None:
        """Advance boards and physics by one servo tick."""
        for rig in self.rigs.values():
            rig.before_tick(self.scene.time, self.scene.period)
        self.scene.tick()
        for rig in self.rigs.values():
            rig.after_tick()

    def serve(self, wait: float) -> bool:
        """Serve what comes within `wait` [s]; return False when the control line was closed."""
        ready, _, _ = select.select(self._ports, [], [], wait)
        now = time.monotonic()
        for rig in self.rigs.values():
            rig.serve(ready, now)
        return sys.stdin not in ready or self._obey()

    def _obey(self) -> bool:
        """Carry out the orders on the control line; return False when it was closed."""
        data = os.read(sys.stdin.fileno(), 65536)
        *lines, self._heard = (self._heard + data).split(b"\n")
        if not data and self._heard:
            lines.append(self._heard)  # It was closed amid a line.
        for line in lines:
            if not self._overlong:  # Else it was answered already.
                print(json.dumps(self._answer(line)), flush=True)
            self._overlong = False
        if len(self._heard) > LONGEST_ORDER:
            if not self._overlong:
                print(json.dumps(self._answer(self._heard)), flush=True)
            self._heard, self._overlong = b"", True
        return bool(data)

    def _answer(self, line: bytes) -> SceneTime | Refusal | dict[str, RobotTruth]:
        """Carry out an order, and return the answer."""
        if len(line) > LONGEST_ORDER:
            return {"error": f"an order of more than {LONGEST_ORDER} bytes"}
        try:
            order = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"error": f"no JSON: {error}"}
        match order:
            case {"do": "tick"}:
                self.tick()
            case {"do": "run"}:
                self.runs = True
            case {"do": "fault"}:
                try:
                    entry = FaultEntry.parse(order)
                    self.rigs[entry.robot].inject(entry.fault())
                except (KeyError, ValueError) as error:
                    return {"error": f"no such fault: {error}"}
            case {"do": "state"}:
                return {name: self._state(name) for name in self.rigs}
            case other:
                words = json.dumps(other)[:40]
                return {"error": f"unknown order {words}; expected do: tick, run, fault or state"}
        return {"time": self.scene.time}

    def _state(self, name: str) -> RobotTruth:
        """Return the true state of a robot."""
        rover, rig = self.scene.rovers[name], self.rigs[name]
        model, data = self.scene.simulation.model, self.scene.simulation.data
        camera = None
        if rig.frames is not None:
            left, _ = self.scene.simulation.heads[name].poses(data)
            camera = _pose_table(left.rotation.as_matrix(), left.translation)
        bodies: dict[str, PoseTable] = {}
        for word, body in (("chassis", f"{name}/chassis"), ("card", f"{name}/card"), ("slot",) * 2):
            index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
            if index >= 0:
                bodies[word] = _pose_table(data.xmat[index].reshape(3, 3), data.xpos[index])
        return {
            "arm_angles": rover.jig_angles().tolist(),
            "angles": rover.angles().tolist(),
            "codes": rover.codes.tolist(),
            "driven": {hex(address): when for address, when in rig.driven.items()},
            "time": self.scene.time,
            "damage": {kind.value: count for kind, count in rig.bus_line.counts.items()},
            "camera": camera,
            "bodies": bodies,
        }

    def close(self) -> None:
        """Close ports and scene."""
        if self._drawing is not None:
            self._drawing.close()
        for rig in self.rigs.values():
            rig.close()
        self.scene.close()


def _pose_table(rotation: FloatArray, translation: FloatArray) -> PoseTable:
    return {"rotation": rotation.tolist(), "translation": translation.tolist()}


def _schedule(path: Path) -> list[object]:
    """Return the entries of a file of faults.

    Raises:
        OSError: If it cannot be read, or is too large.
        ValueError: If it is no JSON list.
    """
    try:
        entries = read_json(path, SETTINGS)
    except ValueError as error:
        raise ValueError(f"{path}: no JSON ({error})") from None
    if not isinstance(entries, list):
        raise ValueError(f"{path}: expected a list of faults")
    return cast("list[object]", entries)


def _scene(options: Options) -> SceneConfig:
    if not options.scene:
        # Two metres apart, side by side.
        places = [RobotPlacement(n, (2.0 * i, 0.0)) for i, n in enumerate(options.robots)]
        stereo = StereoConfig() if options.frames else None
        return SceneConfig(tuple(places), seed=options.seed, stereo=stereo)
    return SceneConfig.from_json(options.scene)


def _modems(options: Options) -> contextlib.AbstractContextManager[tuple[str, str]]:
    """Return the radio's modems, as slow as the robots."""
    usual = ModemConfig()
    config = ModemConfig(
        max(1, round(usual.baud / options.slow_down)), usual.delay * options.slow_down
    )
    return pty_modems(config, np.random.default_rng([options.seed, 6]))


def main() -> int:
    """Serve until the control line is closed or the process is interrupted."""
    options = tyro.cli(Options, description=__doc__)
    if options.parent:
        end_with_parent(options.parent)
    try:
        faults = _schedule(options.faults) if options.faults else []
        scene = _scene(options)
        state = None
        if options.state is not None:
            check_size(options.state, MODEL)
            state = np.load(options.state, allow_pickle=False)
        emulator = Emulator(scene, options.line_faults, faults, options.frames, state)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    with contextlib.ExitStack() as running:
        running.callback(emulator.close)
        if options.realtime and options.frames:
            emulator.draw_apart()
        ports = {name: rig.ports for name, rig in emulator.rigs.items()}
        if options.realtime and len(ports) == 2:  # noqa: PLR2004
            for own, port in zip(ports.values(), running.enter_context(_modems(options))):
                own["radio"] = port
        period = emulator.scene.period
        started: Started = {"ports": ports, "period": period, "time": emulator.scene.time}
        print(json.dumps(started), flush=True)
        emulator.listen()
        wall = period * options.slow_down
        emulator.runs = options.realtime
        due, serving = time.monotonic() + wall, True
        # The second where nobody takes the answers any more.
        running.enter_context(contextlib.suppress(KeyboardInterrupt, BrokenPipeError))
        while serving:
            wait = max(0.0, due - time.monotonic()) if emulator.runs else 0.002
            serving = emulator.serve(wait)
            if not emulator.runs:
                due = time.monotonic() + wall
            elif time.monotonic() >= due:
                emulator.tick()
                due += wall
    return 0


if __name__ == "__main__":
    sys.exit(main())
