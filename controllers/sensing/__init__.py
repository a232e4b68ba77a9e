"""Surrogate sensing: what a sensor should read, by the identified model (Thesis figure 5-6).

- `surrogate_wrench`: the wrench under the arm, and the force at its hand, from the arm's motion.
- `surrogate_tilt`: the tilt of the base under the arm's wrench, through its springs.
- `surrogate`: monitors that replace a sensor that is missing or wrong by its prediction.
"""
