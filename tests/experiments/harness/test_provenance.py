"""A run records what its last bits depend on."""

import os
import platform
import subprocess
import sys

import pytest

from experiments.harness.provenance import linear_algebra


def test_the_linear_algebra_that_numpy_has_loaded_is_named():
    names = linear_algebra()
    assert names and all(name.split()[1][0].isdigit() for name in names)


@pytest.mark.parametrize("kernels", ["Haswell", "Sandybridge"])
def test_selected_kernels_are_reported(kernels):
    code = "import numpy, experiments.harness.provenance as p; print(p.linear_algebra())"
    printed = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "OPENBLAS_CORETYPE": kernels},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    # Only x86 processors have them.
    assert (kernels in printed) == (platform.machine() == "x86_64")
