"""Data of the chapter 2 plant that several tests share: motions, MuJoCo's outputs, noise."""

import functools

import numpy as np

from controllers.identification.arm_motion import (
    MODES,
    ArmLimits,
    ArmState,
    RigidArm,
    Trajectory,
    swing,
)
from controllers.identification.compliant_base import ArmOnMount, BaseState, simulate
from controllers.identification.excitation import random_excitation
from controllers.identification.output_error import Estimate, OutputError, Window
from controllers.identification.parameters import from_mapping
from experiments.ch2.simulation.plant import Plant
from models.datasheets import TABLE_2_1_TRUTH

TRUTH = from_mapping(TABLE_2_1_TRUTH)
ARMS = {mode: ArmOnMount.of(RigidArm(), mode) for mode in MODES}
WINDOW = 80
TIME_STEP = 0.005


@functools.cache
def motion(mode: str, windows: int = 5, seed: int = 0) -> Trajectory:
    """Random feasible excitation, another one in each window."""
    generator = np.random.default_rng([seed, MODES.index(mode)])
    state, whole = ArmState(), None
    for _ in range(windows):
        excitation = random_excitation(ArmLimits(), generator)
        part, state = swing(state, excitation, ArmLimits(), WINDOW, TIME_STEP)
        whole = part if whole is None else whole.then(part)
    assert whole is not None
    return whole


@functools.cache
def recorded(mode: str, windows: int = 5, seed: int = 0) -> np.ndarray:
    """What MuJoCo gives for that motion, free of noise (n, 24)."""
    return Plant(TABLE_2_1_TRUTH, mode).follow(motion(mode, windows, seed))


@functools.cache
def predicted(mode: str, windows: int = 5, seed: int = 0) -> np.ndarray:
    """The same from our own model, finely integrated."""
    path = motion(mode, windows, seed)
    return simulate(TRUTH, ARMS[mode], path, BaseState.at_rest(), False, substeps=4)[0]


def noise_bound(outputs: dict[str, np.ndarray]) -> np.ndarray:
    """A tenth of the greatest value of each channel, (24,)."""
    return 0.1 * np.max([np.abs(samples).max(axis=0) for samples in outputs.values()], axis=0)


def fit(
    outputs: dict[str, np.ndarray],
    paths: dict[str, Trajectory],
    sigma: np.ndarray,
    arms: dict[str, ArmOnMount] | None = None,
) -> Estimate:
    """Fit all of it at once, from the prior."""
    arms = arms or {mode: ARMS[mode] for mode in outputs}
    search = OutputError(arms)
    windows = {mode: Window(paths[mode], outputs[mode], sigma) for mode in outputs}
    search.add(windows)
    return search.fit()


def noisy(
    seed: int, modes=MODES, windows: int = 5, part: float = 1.0
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Outputs with that part of 10 % uniform noise, and its standard deviation."""
    clean = {mode: predicted(mode, windows) for mode in modes}
    bound = part * noise_bound({mode: predicted(mode, windows) for mode in MODES})
    generator = np.random.default_rng(seed)
    outputs = {m: y + generator.uniform(-bound, bound, y.shape) for m, y in clean.items()}
    return outputs, bound / np.sqrt(3)
