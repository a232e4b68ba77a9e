"""A camera placement that BRAID takes on a rover.

- `placement`: the experiment ``appe-placement``: options, metrics and checks.
- `scene`: the rover with BRAID among blocks.
- `trial`: one setting: plan, drive and count what is seen.
- `figures`, `record`: figures and a recording.
"""
