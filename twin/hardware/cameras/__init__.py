"""Stereo pairs of real and emulated cameras.

- `frames`: shared-memory file through which an emulator passes on its scene's pairs.
- `camera`: pairs from two captures, from one that holds both views, or from such a file.
"""
