"""Command line: ``fieldtwin [NAME [options]]``, or ``python -m experiments [NAME [options]]``."""

import dataclasses
import difflib
import importlib.metadata
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext

# Off-screen rendering; must be set before mujoco is imported, also in workers.
if sys.platform == "linux":
    os.environ.setdefault("MUJOCO_GL", "egl")

from experiments.harness import catalogue
from experiments.harness.catalogue import Experiment
from experiments.harness.command_line import BAD_OPTIONS, complain, parse, program
from experiments.harness.contract import (
    ExperimentError,
    OptionError,
    Options,
    RecordedOptions,
)
from experiments.harness.live_viewer import LiveViewer
from experiments.harness.output import Output
from experiments.harness.storage import disk_errors
from experiments.harness.summary import print_summary
from twin.hardware.serial_link import LinkError
from twin.robot import RobotError

FAILURE = 1
INTERRUPTED = 130


def main(
    arguments: Sequence[str] | None = None,
    experiments: Mapping[str, Experiment] = catalogue.EXPERIMENTS,
) -> int:
    """Run one command and return the exit status.

    Args:
        arguments: Words of the command line (those of the process unless given).
        experiments: The experiments to choose from, by name.

    Returns:
        0 when it ran, 1 when it failed, 2 on bad options, 130 when interrupted.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help", "list"):
        print_list(experiments)
        return 0
    if words[0] == "--version":
        print(f"fieldtwin {importlib.metadata.version('fieldtwin')}")
        return 0
    name, *rest = words
    try:
        commands = {**experiments, **catalogue.COMMANDS}
        if name not in commands:
            raise OptionError(_unknown(name, list(commands)))
        command = commands[name]
        options = parse(command, rest)
        if not isinstance(command, Experiment):
            return command.load()(options)
        run_experiment(command, options, rest)
    except (OptionError, ExperimentError, LinkError, RobotError) as error:
        complain(error)
        return BAD_OPTIONS if isinstance(error, OptionError) else FAILURE
    except KeyboardInterrupt:
        complain("interrupted; --resume goes on with what a sweep has finished")
        return INTERRUPTED
    except Exception as error:
        traceback.print_exc()
        complain(f"{name} failed: {type(error).__name__}: {error}")
        return FAILURE
    return 0


def run_experiment(experiment: Experiment, options: Options, arguments: Sequence[str]) -> None:
    """Run an experiment, write its results and print them.

    Args:
        experiment: Entry of the catalogue.
        options: Its options.
        arguments: Words that gave these.

    Raises:
        ExperimentError: If the experiment reports that it is no success, and its results are
            written; if another run has the folder, or the disk refuses to write.
        Exception: What the experiment raised.
    """
    from experiments.harness.figure_style import use_style  # noqa: PLC0415, matplotlib is slow

    use_style()
    run = experiment.load()
    live = isinstance(options, RecordedOptions) and options.live
    if live:  # What is shown is the recording.
        options = dataclasses.replace(options, record=True)
    output = Output(experiment.name, options, arguments)
    shown = closing(LiveViewer(output.file("run.rrd"))) if live else nullcontext()
    with shown as viewer:
        with closing(output), disk_errors(output.directory):
            run(options, output)
            if viewer is not None:
                viewer.finish()
            output.finish()
        print_summary(experiment, output)
        if viewer is not None:
            viewer.stay()
    if output.failure:
        raise ExperimentError(output.failure)


def print_list(experiments: Mapping[str, Experiment]) -> None:
    """Print all experiments and commands, one line each."""
    lines = [(each.name, f"{each.summary} [{each.thesis}]") for each in experiments.values()]
    lines += [(each.name, each.summary) for each in catalogue.COMMANDS.values()]
    width = max((len(name) for name, _ in lines), default=0)
    print(f"usage: {program()} NAME [options]   (NAME --help lists its options)\n")
    for name, text in lines:
        print(f"{name:{width}}  {text}")


def _unknown(name: str, names: Sequence[str]) -> str:
    hint = "".join(f" (did you mean {each}?)" for each in difflib.get_close_matches(name, names, 1))
    return f"unknown experiment {name!r}{hint}; there are {', '.join(names)}"


if __name__ == "__main__":
    sys.exit(main())
