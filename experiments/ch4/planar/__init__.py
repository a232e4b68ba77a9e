"""Cameras are placed on the plane.

- `planar`: the experiment ``ch4-planar``: metrics and checks; its options beside it.
- `scenes`: random scenes, and those of figures 4-8 and 4-10.
- `trials`: searches and hulls compared over random scenes (figure 4-6).
- `motion`: a panel is carried to its target while a camera watches (figure 4-11).
- `figures`, `record`: figures, the film and a recording.
"""
