"""True parameter sets of the simplified plant: Table 2-1's, a user's own, or random ones."""

from pathlib import Path
from typing import Any

import numpy as np

from controllers.identification.excitation import parameter_scale
from controllers.identification.parameters import (
    COUNT,
    DAMPING,
    INERTIA_ELEMENTS,
    LEVER,
    NAMES,
    STIFFNESS,
    ParameterError,
    from_mapping,
)
from experiments.harness.contract import OptionError
from models.datasheets import TABLE_2_1_TRUTH
from perception.geometry.arrays import FloatArray
from perception.geometry.files import SETTINGS, read_json, read_toml

Truth = tuple[float, ...]

TABLE_TRUTH: Truth = tuple(TABLE_2_1_TRUTH[name] for name in NAMES)
"""Table 2-1's true values, in the order of `parameters.NAMES`."""

MASS_RANGE = (0.5, 25.0)
"""Of random bases [kg]."""
GYRATION_RANGE = (0.05, 0.5)
"""Root-mean-square extent of random bases along each principal axis [m]."""
LEVER_RANGE = (0.6, 0.6, 0.4)
"""Greatest distance of a random arm mount from the centre of gravity along x, y, z [m]."""
SPREAD = 10.0
"""Random dampings and stiffnesses lie within this factor of a typical value: two decades."""
SHORTEST_DECAY = 5e-5
"""Least ratio of a random base's inertia to its rotational damping [s]."""
LARGEST = 1e9
"""Greatest magnitude of any parameter in a file, in its SI unit."""
TYPICAL_DAMPING = (150.0, 250.0)
"""Geometric middle of translational [N s/m] and rotational [N m s/rad] damping."""
TYPICAL_STIFFNESS = (1000.0, 2500.0)
"""Geometric middle of translational [N/m] and rotational [N m/rad] stiffness."""


def load_truth(path: Path) -> Truth:
    """Read the 22 true values from a file.

    Args:
        path: JSON or TOML (by its ending) with one number for each of `parameters.NAMES`, SI
            units, either at the top or in a table named "truth".

    Returns:
        (22,) values in the order of `parameters.NAMES`.

    Raises:
        OptionError: If the file cannot be read, or if no body on springs can have its values.
    """
    try:
        content = (read_toml if _kind(path) == "TOML" else read_json)(path, SETTINGS)
    except OSError as error:
        raise OptionError(f"--truth {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise OptionError(f"--truth {path}: not valid {_kind(path)}: {error}") from None
    if isinstance(content, dict) and set(content) == {"truth"}:
        content = content["truth"]
    if not isinstance(content, dict):
        raise OptionError(f"--truth {path}: expected names with numbers, got a {_type(content)}")
    for name, value in content.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise OptionError(f"--truth {path}: {name} is a {_type(value)}, not a number")
        if abs(value) > LARGEST:
            raise OptionError(f"--truth {path}: {name} is beyond {LARGEST:g} SI units")
    try:
        vector = from_mapping(content)
    except ParameterError as error:
        raise OptionError(f"--truth {path}: {error}") from None
    return tuple(vector.tolist())


def _kind(path: Path) -> str:
    return "TOML" if path.suffix.lower() == ".toml" else "JSON"


def _type(value: Any) -> str:
    return {"str": "text", "NoneType": "null"}.get(type(value).__name__, type(value).__name__)


def random_truth(generator: np.random.Generator) -> Truth:
    """Draw a plausible base: any mass distribution, any mount, springs of the usual order.

    The inertia comes from random second moments of mass in random axes, so that a body exists
    that has it.

    Args:
        generator: Source of randomness.

    Returns:
        (22,) values in the order of `parameters.NAMES`.
    """
    vector = np.zeros(COUNT)
    vector[0] = _log_uniform(generator, *MASS_RANGE)
    axes, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    extents = generator.uniform(*GYRATION_RANGE, size=3)
    moments = vector[0] * axes @ np.diag(extents**2) @ axes.T
    tensor = np.trace(moments) * np.eye(3) - moments
    vector[1:7] = [tensor[row, column] for row, column in INERTIA_ELEMENTS]
    vector[LEVER] = generator.uniform(-1, 1, size=3) * LEVER_RANGE
    highest = SPREAD * np.repeat(TYPICAL_DAMPING, 3)
    highest[3:] = np.minimum(highest[3:], np.linalg.eigvalsh(tensor)[0] / SHORTEST_DECAY)
    vector[DAMPING] = _log_uniform(generator, np.repeat(TYPICAL_DAMPING, 3) / SPREAD, highest)
    stiffness = np.repeat(TYPICAL_STIFFNESS, 3)
    vector[STIFFNESS] = _log_uniform(generator, stiffness / SPREAD, stiffness * SPREAD)
    return tuple(vector.tolist())


def _log_uniform(generator: np.random.Generator, low: Any, high: Any) -> Any:
    return np.exp(generator.uniform(np.log(low), np.log(high)))


def error_scale(truth: FloatArray) -> FloatArray:
    """Return what each parameter's error is divided by, (22,); NaN leaves the parameter out.

    Table 2-1's own values: the parameter's magnitude, zeros left out. Any other truth: the
    magnitude too, but at least a tenth of the mean moment of inertia for products of inertia and
    0.03 m for the lever, which may lie arbitrarily close to zero.

    Args:
        truth: (22,) true values.
    """
    if np.array_equal(truth, TABLE_TRUTH):
        return np.where(truth == 0, np.nan, np.abs(truth))
    return parameter_scale(truth)


def relative_errors(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return |error| of each parameter relative to `error_scale`, (22,) [%]; NaN if left out."""
    return 100 * np.abs(estimate - truth) / error_scale(truth)


def average_error(estimate: FloatArray, truth: FloatArray) -> float:
    """Return the mean of `relative_errors` over the parameters that count [%]."""
    return float(np.nanmean(relative_errors(estimate, truth)))
