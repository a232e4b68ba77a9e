"""Surrogate sensing, and diagnosis: what sensors should read, and what has changed on a robot.

- `surrogate_models`: the wrench under the arm by its motion, and the base's tilt by that wrench.
- `surrogate`: monitors that replace a sensor that is missing or wrong by its prediction (Thesis
  figure 5-6).
- `wheel_grip`: friction under each wheel, from its own spin.
- `diagnosis`: a load on the base, soft springs or a worn tyre, by name and size.
- `changes`: what may have changed, found in the innovations of a twin that runs beside the robot.
- `trial`: which of that it was, and how large, by copies of the twin that have it.
- `jumps`, `loose_camera`: encoders whose zero jumps, and an eye that turned in its head.
- `consequences`, `probing`, `foresight`: what a change means, the motion that tells more of it, and
  how well a twin predicts.
"""
