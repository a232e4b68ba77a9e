"""A twin of one's own robot, for any MuJoCo model: identify it from logs, and replay its runs.

In reading order:

- `identification`: logs in, parameters and a verdict out. `identify` is its command, `pages` writes
  what it found: a page, a model, tables.
- `excite`: the motion that will tell most.
- `replay`: the commands of a log once more in simulation, beside what was measured.
- `robots/`: three robots that are not ours.
"""
