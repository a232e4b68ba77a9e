"""Recordings and pictures for the rerun viewer.

- `record`: a run, logged as it goes on; `layout`: arrangements of the viewer.
- `scene_mesh`: a scene's geometry as meshes.
"""
