"""A camera guides an object to its goal among obstacles (Table 4-1).

- `montecarlo`: the experiment ``ch4-montecarlo``: the table beside the thesis'.
- `scenario`: the numbers, with their reasons, and random worlds.
- `sight`: what a camera sees, and how well.
- `trial`: one test, compiled.
- `orderings`: which cells must be better than which.
- `figures`, `record`: figures and a recording.
"""
