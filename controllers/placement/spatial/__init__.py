"""The best view in space, in reading order.

- `occluders`: solids, clusters of voxels, and expansion by the target (section 4.2.3.3).
- `field`: target field visibility behind expanded occluders, compiled.
- `sight`: exact visibility of a whole target (figure 4-6).
- `best_first`: tree of directions and the searches over it, compiled.
- `search`: the task, and its best view or the reasons why there is none.
"""
