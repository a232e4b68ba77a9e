"""Camera placement for a task (Thesis chapter 4), in reading order.

- `task`: target, occluder, lens, and the rating of a view (section 4.2.3).
- `planar/`: the best view on the plane (section 4.2.3, figures 4-4 to 4-8).
- `spatial/`: the best view in space.
- `pairs`: two cameras at once.
- `moving`: moving objects, and a camera that follows with hysteresis (section 4.3.1).
- `mapped_ground`: free ground, paths and occluders of a target, from a map.
"""
