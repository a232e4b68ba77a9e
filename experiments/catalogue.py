"""All experiments and commands by name; modules are imported only when asked for."""

from __future__ import annotations

from experiments.contract import Experiment

_ALL: tuple[Experiment, ...] = ()

EXPERIMENTS = {experiment.name: experiment for experiment in _ALL}

# name -> (module with main(arguments) -> exit status, summary)
COMMANDS: dict[str, tuple[str, str]] = {}
