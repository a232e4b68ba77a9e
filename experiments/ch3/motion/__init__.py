"""The camera's motion, and points by two robots together: parts of ``ch3-stereo``.

- `motion`: random motions and five solvers on drawn image points (figure 3-24).
- `rendered`: the same on rendered pairs (figure 3-23).
- `cooperative`: two robots triangulate together, on drawn image points (section 6.2 (a)).
- `cooperative_rendered`: the same on rendered pairs.
- `scores`: errors of points and poses against truth and covariance.
- `figures`: the figures of all four.
"""
