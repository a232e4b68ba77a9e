"""Robots, simulated or real.

In reading order:

- `robot`: the contract of every robot; `description`: a robot as drawn;
  `link`: the radio of a controller.
- `connect`: robots by a target named on the command line.
- `loop`, `clock`: observe, decide, command, wait.
- `describe`: descriptions from a model as drawn; `realism`: how far robots and sensors are from it.
- `simulation`: a MuJoCo scene and its robots, stepped together.
- `servo`: commands into motor duty; `sensors`, `sensor_bank`: measurements with noise.
- `camera`: stereo heads, drawn when a pair is read; `optics`: what lenses, shutters and mountings
  make of it.
- `recording`: recordings and pictures for the rerun viewer; `logs`: logs of any robot, in and out.
- `prediction`: any MuJoCo model's parameters by name, and what its sensors would read.
- `shadow`: a twin that runs beside a rover, and what it did not expect.
- `environment`: the same scene for dm_control.
- `hardware`: robots over real and emulated boards (thesis appendix D).
"""

import os

# Without a display MuJoCo would pick GLFW and fail; this must come before its import.
os.environ.setdefault("MUJOCO_GL", "egl")
