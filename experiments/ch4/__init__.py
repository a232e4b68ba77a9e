"""Placement of cameras (chapter 4).

- `planar`: on the plane, by the thesis' algorithm (figures 4-6, 4-8, 4-10, 4-11).
- `spatial`: in space, among blocks (figures 4-4, 4-12, 4-13).
- `montecarlo`: many tests of a camera that guides an object (Table 4-1).
"""
