"""``python -m experiments doctor``: the state of this machine or of a robot.

- `doctor`: versions, renderer and packages.
- `render_probe`: one test frame in a process of its own.
- `findings`: the result of one check.
- `robot`: ``doctor --robot``: a robot on its boards, before anything moves.
"""
