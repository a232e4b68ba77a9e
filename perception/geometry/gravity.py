"""The acceleration of free fall."""

from typing import Final

GRAVITY: Final = 9.81
"""Acceleration of free fall [m/s^2], MuJoCo's default."""
