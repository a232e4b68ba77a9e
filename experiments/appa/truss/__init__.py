"""Two rovers hold one segment and insert it in a truss stage (figures A-8 to A-12).

- `truss`: the experiment ``appa-truss``: options, metrics and figures A-10 to A-12.
- `bench`: the scene at rest, and the truth of it.
- `trial`: one insertion.
"""
