"""Options from the command line, and errors from them in one line."""

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import tyro

from experiments.harness.contract import OptionError

Parsed = TypeVar("Parsed")

BAD_OPTIONS = 2
BOX = re.compile(r"[╭╮╰╯│─]+")
OWN = re.compile(r"^(Error parsing )?(\w*Options: )?")
ADVICE = ("Perhaps you meant", "Similar", "Argument helptext", "For full helptext", "Got errors")


def program() -> str:
    """Return how this program was called."""
    return "fieldtwin" if Path(sys.argv[0]).stem == "fieldtwin" else "python -m experiments"


def parse(options_type: type[Parsed], name: str, summary: str, arguments: Sequence[str]) -> Parsed:
    """Return the options of a command.

    Args:
        options_type: A dataclass; its docstring's attributes are the help texts.
        name: Name of the command.
        summary: Description of the command in the help.
        arguments: Words after the name.

    Raises:
        OptionError: If they are bad.
        SystemExit: After printing help.
    """
    command = f"{program()} {name}"
    messages = io.StringIO()
    try:
        with contextlib.redirect_stderr(messages):
            return tyro.cli(
                options_type,
                prog=command,
                description=summary,
                args=list(arguments),
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if stop.code in (None, 0):
            raise
        raise OptionError(f"{_one_line(messages.getvalue())}; see {command} --help") from None


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
