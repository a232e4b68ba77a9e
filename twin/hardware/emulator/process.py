"""Emulated boards in a process of their own, and its clock."""

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any, cast

from twin.hardware.emulator.messages import Order, RobotTruth, Started
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.serial_link import LinkError


class EmulatorProcess:
    """A running emulator; time passes by `tick`, or by itself if it runs in real time.

    Attributes:
        process: Number of the process.
        ports: Ports at which a host finds the boards, by robot name.
        period: Servo tick [s].
        time: Time of the last tick [s].
    """

    def __init__(
        self,
        scene: SceneConfig,
        line_faults: float = 0.0,
        realtime: bool = False,
        slow_down: float = 1.0,
        state: Path | None = None,
        patience: float = 60.0,
    ) -> None:
        """Start the process and wait until its boards have power.

        Args:
            scene: Robots, ground and cameras.
            line_faults: Share of the exchanges with the motor boards that are damaged.
            realtime: Whether the emulator runs on the wall clock rather than on request.
            slow_down: Wall-clock time over the emulator's time, with `realtime`.
            state: File of a state of the physics to begin with; None for the scene at rest.
            patience: Longest wait for any answer [s].

        Raises:
            LinkError: If it does not start in time.
        """
        command = [sys.executable, "-m", "twin.hardware.emulator", "--scene", scene.to_json()]
        command += ["--line-faults", str(line_faults), "--parent", str(os.getpid())]
        command += ["--realtime", "--slow-down", str(slow_down)] if realtime else []
        command += ["--state", str(state)] if state else []
        self._patience = patience
        self._frames = contextlib.ExitStack()
        if scene.stereo is not None:
            folder = self._frames.enter_context(tempfile.TemporaryDirectory(prefix="fieldtwin-"))
            command += ["--frames", folder]
        # In a session of its own: Ctrl+C is for this process, which has yet to stop the robots.
        self._process = subprocess.Popen(  # noqa: S603
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,
        )
        try:
            started: Started = self._read()
        except BaseException:
            self.close()
            raise
        self.process = self._process.pid
        self.ports = started["ports"]
        self.period = started["period"]
        self.time = started["time"]

    def tick(self) -> None:
        """Advance by one servo tick.

        Raises:
            LinkError: If the process is gone, or does not answer in time.
        """
        self.time = self._ask({"do": "tick"})["time"]

    def inject(self, robot: str, kind: str, duration: float = 1e9, address: int = 0x80) -> None:
        """Let a fault begin at the next tick.

        Args:
            robot: Name of the robot that it happens to.
            kind: Value of `emulator.faults.RobotFault` or `CameraFault`.
            duration: Duration of the fault [s].
            address: Address of the motor board concerned.
        """
        order: Order = {"do": "fault", "robot": robot, "time": self.time, "kind": kind}
        self.time = self._ask({**order, "duration": duration, "address": address})["time"]

    def run(self) -> None:
        """Let time pass by itself from now on."""
        self._ask({"do": "run"})

    def state(self) -> dict[str, RobotTruth]:
        """Return, by robot, what a person beside it could measure."""
        return self._ask({"do": "state"})

    def close(self) -> None:
        """Stop the process."""
        # A process that died leaves an order that nobody takes.
        with contextlib.suppress(BrokenPipeError):
            cast("IO[str]", self._process.stdin).close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        cast("IO[str]", self._process.stdout).close()
        self._frames.close()

    def _ask(self, order: Order) -> Any:
        """Return the decoded answer to an order."""
        try:
            stream = cast("IO[str]", self._process.stdin)
            stream.write(json.dumps(order) + "\n")
            stream.flush()
        except (OSError, ValueError) as error:
            raise LinkError(f"the emulator is gone ({error})") from None
        return self._read()

    def _read(self) -> Any:
        stream = cast("IO[str]", self._process.stdout)
        # One answer at a time, so that none can wait in the stream's own buffer.
        if not select.select([stream], [], [], self._patience)[0]:
            raise LinkError(f"the emulator did not answer within {self._patience:g} s")
        line = stream.readline()
        if not line:
            raise LinkError("the emulator ended; its own message is above")
        answer = json.loads(line)
        if "error" in answer:
            raise LinkError(f"emulator: {answer['error']}")
        return answer
