"""Software rendering for the tests, whatever is imported first."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")
