"""``python -m twin.hardware.emulator``: boards to connect to, with the physics behind them.

Without ``--realtime`` the physics stand still until a line on the standard input says
``{"do": "tick"}``: time passes out of band, never by a command on the bus, which a retry would
repeat. Every line is answered by one line.
"""

import contextlib
import dataclasses
import functools
import json
import os
import selectors
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro

from models.compose import RobotPlacement
from twin.camera import StereoConfig, camera_pose
from twin.hardware.emulator.drawing import DrawingProcess
from twin.hardware.emulator.faults import CameraFault, LineFaultConfig, RobotFault, ScheduledFault
from twin.hardware.emulator.messages import PoseTable, RobotTruth
from twin.hardware.emulator.modem import ModemConfig, PtyModems
from twin.hardware.emulator.rig import EmulatedRig
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig


@dataclasses.dataclass(frozen=True)
class Options:
    """Emulated boards of rovers on pseudo-terminals and loopback UDP.

    Attributes:
        robots: Names of the rovers; each needs a file in calibration/.
        realtime: Let the physics run on the wall clock at 100 Hz, and two robots' radio with them.
        slow_down: With --realtime, how many times slower than the wall's the robots' time is; the
            host says the same, as slow_down=N behind serial:PORT.
        seed: Random seed of all noise and damage.
        line_faults: Share of the exchanges with the motor boards that are damaged, 0 to 1.
        faults: File with scheduled faults: a JSON list of {"robot", "time" [s], "kind",
            "duration" [s], "address"}.
        scene: JSON of a `SceneConfig`, for programs; overrides robots and seed.
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
    frames: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None


class Emulator:
    """Scene, rigs and the loop that serves them."""

    def __init__(
        self,
        scene: SceneConfig,
        line_faults: float,
        faults: list[dict[str, Any]],
        frames: Path | None = None,
    ) -> None:
        """Build the scene and power the boards on.

        Args:
            scene: What is emulated.
            line_faults: Share of damaged exchanges.
            faults: Scheduled ones, as in the file.
            frames: Folder for stereo pairs; None to keep them.

        Raises:
            ValueError: If a fault is of a robot or board that is not there, or of no known kind.
            CalibrationError: If a robot's calibration cannot be used.
        """
        self._drawing: DrawingProcess | None = None
        self.scene = EmulatedScene(scene)
        names = list(self.scene.rovers)
        for entry in faults:
            if entry.get("robot", names[0]) not in names:
                raise ValueError(f"fault of robot {entry['robot']!r}: there are {', '.join(names)}")
        config = LineFaultConfig(line_faults)
        sources = np.random.default_rng([scene.seed, 5]).spawn(len(self.scene.rovers))
        self.rigs = {
            name: EmulatedRig(rover, config, _faults_of(name, faults), source, frames)
            for (name, rover), source in zip(self.scene.rovers.items(), sources, strict=True)
        }
        self._selector = selectors.DefaultSelector()
        for rig in self.rigs.values():
            self._selector.register(rig.bus, selectors.EVENT_READ, rig.serve_bus)
            self._selector.register(rig.analogue, selectors.EVENT_READ, rig.serve_analogue)
            self._selector.register(rig.wrench, selectors.EVENT_READ, rig.serve_wrench)

    def draw_apart(self) -> None:
        """Have stereo pairs drawn by a process of their own from now on."""
        heads = self.scene.simulation.heads
        self._drawing = DrawingProcess(heads)
        for name in heads:
            self.rigs[name].draw_apart = functools.partial(self._drawing.newest, name)

    def listen(self) -> None:
        """Take control lines from the standard input."""
        self._selector.register(sys.stdin.fileno(), selectors.EVENT_READ, None)

    def tick(self) -> None:
        """Advance boards and physics by one servo tick."""
        for rig in self.rigs.values():
            rig.before_tick(self.scene.time, self.scene.period)
        self.scene.tick()
        for rig in self.rigs.values():
            rig.show()

    def serve(self, wait: float) -> bool:
        """Serve what comes within `wait` [s]; return False when the control line was closed."""
        for key, _ in self._selector.select(wait):
            if key.data is not None:
                key.data(time.monotonic())
            elif not self._obey():
                return False
        now = time.monotonic()
        for rig in self.rigs.values():
            rig.serve_late(now)
            rig.serve_frames()
        return True

    def _obey(self) -> bool:
        """Carry out what stands on the control line."""
        data = os.read(sys.stdin.fileno(), 65536)
        if not data:
            return False
        for line in data.splitlines():
            print(json.dumps(self._answer(json.loads(line))), flush=True)
        return True

    def _answer(self, order: dict[str, Any]) -> dict[str, Any]:
        match order["do"]:
            case "tick":
                self.tick()
                return {"time": self.scene.time}
            case "fault":
                try:
                    self.rigs[order["robot"]].inject(_fault(order))
                except (KeyError, ValueError) as error:
                    return {"error": f"no such fault: {error}"}
                return {"time": self.scene.time}
            case "state":
                return {name: self._state(name) for name in self.rigs}
            case other:
                return {"error": f"unknown order {other!r}"}

    def _state(self, name: str) -> RobotTruth:
        """Return what a person beside the robot could measure."""
        rover, rig = self.scene.rovers[name], self.rigs[name]
        damage = {kind.value: count for kind, count in rig.bus_line.counts.items()}
        return {
            "arm_angles": rover.angles()[4:].tolist(),
            "angles": rover.angles().tolist(),
            "codes": rover.codes.tolist(),
            "damage": damage,
            "camera": self._camera(name) if rig.frames else None,
            "bodies": self._bodies(name),
        }

    def _bodies(self, name: str) -> dict[str, PoseTable]:
        """Return the true poses of a robot's chassis, of its card and of the slot, if any."""
        model, data = self.scene.simulation.model, self.scene.simulation.data
        names = {"chassis": f"{name}/chassis", "card": f"{name}/card", "slot": "slot"}
        found: dict[str, PoseTable] = {}
        for word, body in names.items():
            index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
            if index >= 0:
                rotation, place = data.xmat[index].reshape(3, 3), data.xpos[index]
                found[word] = {"rotation": rotation.tolist(), "translation": place.tolist()}
        return found

    def _camera(self, name: str) -> PoseTable:
        """Return the left camera's true pose in the world."""
        physics = self.scene.simulation
        index = int(physics.model.camera(f"{name}/stereo_left").id)
        rotation, translation = camera_pose(physics.data, index)
        return {"rotation": rotation.tolist(), "translation": translation.tolist()}

    def close(self) -> None:
        """Take ports and scene down."""
        if self._drawing is not None:
            self._drawing.close()
        self._selector.close()
        for rig in self.rigs.values():
            rig.close()
        self.scene.close()


def _fault(entry: dict[str, Any]) -> ScheduledFault:
    """Return a fault from its words.

    Raises:
        ValueError: Naming what is missing or unknown, and the kinds that there are.
    """
    kinds = {kind.value: kind for kind in (*RobotFault, *CameraFault)}
    if entry.get("kind") not in kinds:
        raise ValueError(f"kind {entry.get('kind')!r}; expected one of {', '.join(kinds)}")
    if "time" not in entry:
        raise ValueError(f"{entry['kind']} has no time")
    fields = {key: entry[key] for key in ("time", "duration", "address") if key in entry}
    return ScheduledFault(kind=kinds[entry["kind"]], **fields)


def _faults_of(name: str, faults: Sequence[dict[str, Any]]) -> list[ScheduledFault]:
    return [_fault(entry) for entry in faults if entry.get("robot", name) == name]


def _scene(options: Options) -> SceneConfig:
    if not options.scene:
        # Two metres apart, side by side.
        places = [RobotPlacement(n, (2.0 * i, 0.0)) for i, n in enumerate(options.robots)]
        stereo = StereoConfig() if options.frames else None
        return SceneConfig(tuple(places), seed=options.seed, stereo=stereo)
    return SceneConfig.from_json(options.scene)


def _modems(options: Options) -> PtyModems:
    """Return the radio's modems, as slow as the robots."""
    usual = ModemConfig()
    config = ModemConfig(
        max(1, round(usual.baud / options.slow_down)), usual.delay * options.slow_down
    )
    return PtyModems(config, np.random.default_rng([options.seed, 6]))


def main() -> int:
    """Serve until the control line is closed or the process is interrupted."""
    options = tyro.cli(Options, description=__doc__)
    faults: list[dict[str, Any]] = []
    try:
        if options.faults:
            faults = json.loads(options.faults.read_text())
        emulator = Emulator(_scene(options), options.line_faults, faults, options.frames)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    if options.realtime and options.frames:
        emulator.draw_apart()
    ports = {name: rig.ports for name, rig in emulator.rigs.items()}
    modems = contextlib.ExitStack()
    if options.realtime and len(ports) == 2:  # noqa: PLR2004
        radio = modems.enter_context(_modems(options))
        for name, port in zip(ports, radio.ports):
            ports[name] = {**ports[name], "radio": port}
    period = emulator.scene.period
    print(json.dumps({"ports": ports, "period": period, "time": emulator.scene.time}), flush=True)
    emulator.listen()
    wall = period * options.slow_down
    due, serving = time.monotonic() + wall, True
    try:
        while serving:
            wait = max(0.0, due - time.monotonic()) if options.realtime else 0.002
            serving = emulator.serve(wait)
            if options.realtime and time.monotonic() >= due:
                emulator.tick()
                due += wall
    except KeyboardInterrupt:
        pass
    finally:
        emulator.close()
        modems.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
