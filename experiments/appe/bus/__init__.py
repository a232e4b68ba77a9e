"""Pulses on BRAID's power line (figures E-7, E-8).

- `bus`: the experiment ``appe-bus``: metrics and checks; its options beside it.
- `trial`: random words by one protocol, with noise and faults.
- `figures`: the figures.
"""
