"""Identification of any model that predicts what its sensors read.

- `fit`: what measurements can tell of each parameter, and the most probable parameters.
"""
