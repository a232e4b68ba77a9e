"""Holes of the work-piece in `models.blocks`, apart from its scene: options need no more."""

HOLES: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.06, -0.035), (0.06, 0.035))
"""(x, y) of the holes' middles [m]; the first is at the origin."""
