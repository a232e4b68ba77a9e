"""The best view on the plane, in reading order.

- `sight`: occupancy map of the plane, and exact visibility of a whole target (figure 4-6).
- `field`: target field visibility behind expanded occluders, compiled (figures 4-4a, 4-5).
- `occluders`: clusters of a map, and expansion by the target (section 4.2.3.3).
- `arc_search`: the searches over rings and arcs, compiled.
- `search`: the task, and its best view or the reasons why there is none.
"""
