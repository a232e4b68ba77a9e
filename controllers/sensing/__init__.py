"""Surrogate sensing: what a sensor should read, by the identified model (Thesis figure 5-6).

- `surrogate_models`: the wrench under the arm by its motion, and the base's tilt by that wrench.
- `surrogate`: monitors that replace a sensor that is missing or wrong by its prediction.
"""
