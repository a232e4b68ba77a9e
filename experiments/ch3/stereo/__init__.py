"""Two rovers map a cluttered field with stereo heads (figures 3-22 to 3-27).

- `stereo`: the experiment ``ch3-stereo`` and its parts.
- `scene`: the field with its panel, rovers and a free stereo rig.
- `truth`: the true surface, which only scores.
- `noise`: the depth noise of the stereo heads (eq. 3-6).
- `trial`: one scene mapped by two rovers.
- `figures`, `record`: figures and a recording.
"""
