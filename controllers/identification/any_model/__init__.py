"""Identification of any model that predicts what its sensors read.

- `motion`: motions that tell most, within limits.
- `fit`: what measurements can tell of each parameter, and the most probable parameters.
"""
