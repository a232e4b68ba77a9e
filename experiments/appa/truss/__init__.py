"""Two rovers hold one segment and insert it in a truss stage (figures A-8 to A-12).

- `truss`: the experiment ``appa-truss``: options and metrics.
- `bench`: the scene at rest, and the truth of it.
- `trial`: one insertion.
- `figures`: figures A-10 to A-12, and forces by misalignment.
"""
