"""Is the plant the equations, are the equations the plant, and what can they not tell?"""

from __future__ import annotations

from experiments.output import Output


def verify(output: Output, seed: int) -> None:
    """Measure and check what does not depend on the sweep."""
