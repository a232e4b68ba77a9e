"""The motions that are compared: one that was designed, a chirp, and a random Fourier series.

All are as long, of the same frequencies, and as large as the same limits allow.
"""

import dataclasses
from pathlib import Path

import numpy as np

from controllers.identification.any_model.motion import BLEND, Series, largest
from experiments.own.excite import best_shape, home
from experiments.own.excite_options import Options
from experiments.own.hidden.hidden_robots import KINDS, PERIOD, Kind
from perception.geometry.arrays import FloatArray
from twin.prediction.limits import Limits
from twin.prediction.parameters import explicit, select

LOWEST = 0.1
"""Frequency at which a chirp begins [Hz]."""


@dataclasses.dataclass(frozen=True)
class DesignTrial:
    """One motion to design.

    Attributes:
        kind: Kind of robot.
        duration: Its duration [s].
        generations: Generations of the search.
        seed: Seed of the search.
    """

    kind: str
    duration: float
    generations: int
    seed: int


@dataclasses.dataclass(frozen=True)
class Chirp:
    """Sines of all commands about those at rest, of one rising frequency, evenly out of phase.

    Attributes:
        home: (k,) commands at rest.
        duration: Duration [s].
        highest: Frequency at the end [Hz].
    """

    home: FloatArray
    duration: float
    highest: float

    def commands(self, shape: FloatArray, stamps: FloatArray) -> FloatArray:
        """Return a motion (n, k) at some times (n,) for an amplitude (1,)."""
        rise = (self.highest - LOWEST) / (2.0 * self.duration)
        turns = LOWEST * stamps + rise * stamps**2
        phases = np.arange(len(self.home)) / len(self.home)
        way = np.clip(np.minimum(stamps, self.duration - stamps) / BLEND, 0.0, 1.0)
        waves = np.sin(2.0 * np.pi * (turns[:, None] + phases))
        return self.home + shape[0] * way[:, None] * waves


def series_of(kind: Kind, duration: float) -> Series:
    """Return the Fourier series of a kind's motions."""
    return Series(home(kind.spec().compile(), ()), duration, kind.highest)


def designed(trial: DesignTrial) -> FloatArray:
    """Design a motion for a robot as drawn, and return its shape."""
    kind = KINDS[trial.kind]
    spec = kind.spec()
    options = Options(
        kind.path,
        kind.parameters,
        Path("motion.csv"),
        duration=trial.duration,
        highest=kind.highest,
        generations=trial.generations,
        seed=trial.seed,
    )
    parameters = select(explicit(spec), kind.parameters, {})
    limits = Limits.of_model(spec.compile())
    return best_shape(
        spec, parameters, series_of(kind, trial.duration), limits, options, lambda step, best: None
    )


def commands(motion: Series | Chirp, shape: FloatArray) -> FloatArray:
    """Return commands (m, k), one a `PERIOD`."""
    return motion.commands(shape, np.arange(0.0, motion.duration, PERIOD))


def fitted(kind: Kind, motion: Series | Chirp, shape: FloatArray) -> FloatArray:
    """Return commands (m, k) of a shape that is as large as the limits of the drawing allow."""
    model = kind.spec().compile()
    limits = Limits.of_model(model)
    steps = np.arange(0.0, motion.duration, model.opt.timestep)

    def excess(scaled: FloatArray) -> float:
        return limits.excess(model, motion.commands(scaled, steps))

    return commands(motion, largest(shape, excess, 0.1))
