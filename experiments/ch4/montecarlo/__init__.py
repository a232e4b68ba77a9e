"""A camera guides an object to its goal among obstacles (Table 4-1).

- `montecarlo`: the experiment ``ch4-montecarlo``: the table compared with the thesis.
- `scenario`: parameters of the scenario, and random worlds.
- `sight`: visibility of markers, and the variance of a sighting.
- `trial`: one test, compiled.
- `orderings`: which cells must be better than which.
- `figures`, `record`: figures and a recording.
"""
