"""Motions of a loaded arm that tip the rover, and guards against it (figure A-4, eq. A-5).

- `tipover`: the experiment ``appa-tipover``: options, metrics and figures.
- `scene`: the loaded rover on its slope, and the truth of it.
- `trial`: one swing of a load, guarded or not.
"""
