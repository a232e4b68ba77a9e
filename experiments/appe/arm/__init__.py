"""Kinematics of the binary arm.

- `workspace`: the experiment ``appe-workspace``: all words of five stages (figure E-5).
- `inverse`: the experiment ``appe-inverse``: words for target poses (section E.3.2).
- `inverse_trial`: targets solved by every method, and words that keep clear of obstacles.
"""
