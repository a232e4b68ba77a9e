"""Geometry that every room shares; it lies below all rooms.

- `se3`: rigid motions: exponential, logarithm, adjoint, transport of covariances.
- `pinhole`: intrinsics of cameras, lens distortion, field of view.
- `gravity`: the acceleration of free fall.
- `arrays`: names of array types; `checks`: checks of configurations.
- `kernel_cache`: where compiled kernels are kept on a machine where little can be written.
- `files`: limits of files that are read; files that are written whole or not at all.
"""
