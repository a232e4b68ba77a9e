"""``living-twin``: what a twin beside a rover notices, by name, size and delay.

In reading order:

- `happenings`: what happens to a simulated rover.
- `trial`: one rover, its twin, and one happening.
- `living_twin`: the experiment.
"""
