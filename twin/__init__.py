"""What a robot does, simulated or real: the contract, the loop, the sensors, the recording."""

import os

# Without a display MuJoCo would pick GLFW and fail; this must stand before it is imported.
os.environ.setdefault("MUJOCO_GL", "egl")
