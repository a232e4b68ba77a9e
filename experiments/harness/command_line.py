"""Options from the command line, and errors from them in one line."""

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

from experiments.harness.catalogue import Command, Experiment
from experiments.harness.contract import OptionError

BAD_OPTIONS = 2
BOX = re.compile(r"[╭╮╰╯│─]+")
OWN = re.compile(r"^(Error parsing )?(\w*Options: )?")
ADVICE = ("Perhaps you meant", "Similar", "Argument helptext", "For full helptext", "Got errors")


def program() -> str:
    """Return how this program was called."""
    return "fieldtwin" if Path(sys.argv[0]).stem == "fieldtwin" else "python -m experiments"


def parse(command: Command, arguments: Sequence[str]) -> Any:
    """Return the options of a command.

    Args:
        command: Entry of the catalogue; the docstring of its options has the help texts.
        arguments: Words after the name.

    Raises:
        OptionError: If they are bad.
        SystemExit: After printing help.
    """
    called = f"{program()} {command.name}"
    messages = io.StringIO()
    try:
        with contextlib.redirect_stderr(messages):
            return tyro.cli(
                command.options_type(),
                prog=called,
                description=f"{command.summary}\n\n{_more(command, called)}",
                args=list(arguments),
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if stop.code in (None, 0):
            raise
        raise OptionError(f"{_one_line(messages.getvalue())}; see {called} --help") from None


def _more(command: Command, called: str) -> str:
    """Return an example, and how long a run takes."""
    example = f"Example: {called} {command.example}"
    if not isinstance(command, Experiment):
        return example
    full = f", a full one about {command.full}" if command.full else ""
    takes = f"A quick run takes {command.quick} on two cores{full}."
    return f"{example}\n\n{takes} Reproduces: {command.thesis}."


def complain(message: object) -> None:
    """Print an error in one line."""
    print(f"error: {' '.join(str(message).split())}", file=sys.stderr)


def _one_line(box: str) -> str:
    """Return the message of a framed, wrapped error, without its frame and its advice."""
    lines = [BOX.sub("", line).strip() for line in box.splitlines()[1:]]
    kept: list[str] = []
    for line in lines:
        if line.startswith(ADVICE) or (kept and not line):
            break
        kept.append(line)
    message = " ".join(" ".join(kept).split()).rstrip(".:")
    return OWN.sub("", message)
