"""A camera placement that BRAID takes on a rover.

- `placement`: the experiment ``appe-placement``: options, metrics, checks and figures.
- `scene`: the rover with BRAID among blocks.
- `trial`: one setting: plan, drive and count what is seen.
- `record`: a recording of one setting.
"""
