"""``python -m experiments doctor``: what this machine or a robot lacks.

- `doctor`: versions, renderer and packages.
- `render_probe`: one test frame in a process of its own.
- `findings`: what one check found.
- `robot`: ``doctor --robot``: a robot on its boards, before anything moves.
"""
