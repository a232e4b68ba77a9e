"""Height of the ground by cells of a level grid, in reading order.

- `grid`: where the cells lie.
- `map`: `ElevationMap`, a height and its variance for each cell.
- `submaps`: several of them one after the other, as heights drift.
- `alignment`: a view as it fits a map.
- `fusion`: a view's points to a height of each cell, and its update.
- `ground`: heights of cells above the ground about them.
- `deltas`: what changed in a tile, in few bytes for the radio (appendix C).
"""
