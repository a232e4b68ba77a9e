"""Mapping by cooperating robots (chapter 3).

- `planar`: planar worlds, methods to choose the next view, and swarms (sections 3.2 to 3.5).
- `stereo`: two rovers with stereo heads before a cluttered field (section 3.6).
- `motion`: the camera's motion by fiducials, and cooperative stereo (sections 3.4, 6.2 (a)).
"""
