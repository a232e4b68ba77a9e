"""Maps of space as voxels, in reading order.

- `grid`: a box of voxels, and checks of what enters a map.
- `occupancy`: probability, log-odds and states of a cell.
- `map`: `VoxelMap`, the sparse map with surface estimates.
- `bricks`: its storage.
- `scan`: a scan arranged in the camera's pixels.
- `fusion`: surface estimates from the points of a scan.
- `carving`: free space before them.
- `views`: visible volume and expected information of views (thesis section 3.2.4 in 3-D).
- `files`: maps on disk, exported points and meshes.
- `dense`: a dense map with the rays of OctoMap, to compare with.
"""
