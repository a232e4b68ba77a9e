"""Emulated boards whose time passes by itself, started as a user starts them."""

import contextlib
import json
import subprocess
import sys

from twin.describe import describe_rover


@contextlib.contextmanager
def serial_target(robots, slow_down, frames):
    """Yield what `connect` opens the robots' ports by, and end the emulator afterwards.

    Args:
        robots: Names of the robots.
        slow_down: Wall-clock time over the robots' time.
        frames: Folder for the stereo pairs.
    """
    command = [sys.executable, "-m", "twin.hardware.emulator", "--robots", *robots, "--realtime"]
    command += ["--slow-down", str(slow_down), "--frames", str(frames)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with process:
        ports = json.loads(process.stdout.readline())["ports"]
        yield ",".join(_words(name, ports[name], slow_down) for name in robots)
        # The emulator ends with its control line; leaving its context closes that and waits.


def _words(name, ports, slow_down):
    home = ":".join(map(str, describe_rover(name).arm.home))
    return (
        f"serial:{ports['bus']},analogue={ports['analogue']},wrench=127.0.0.1:{ports['wrench']},"
        f"stereo={ports['stereo']},radio={ports['radio']},robot={name},home={home},"
        f"most_days=99999,slow_down={slow_down}"
    )
