"""Images and points to geometry: pure NumPy, OpenCV and numba."""
