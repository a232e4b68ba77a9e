"""A camera is placed in space.

- `stereo`: the experiment ``ch4-stereo``: metrics and checks; its options beside it.
- `search`: random scenes, searched exhaustively and fast, and hulls against exact sight.
- `blocks`: blocks about a work-piece, planned on an uncertain model and scored by rendering.
- `figures`, `record`: figures 4-4, 4-12 and 4-13, and a recording.
- `placement_scene`: the scene of chapter 3 as a voxel map with targets, for the benchmark.
"""
