"""Kinematics and dynamics of serial chains (Thesis section A.1, eqs A-2 and A-4).

- `rigid_motion`: motion of a frame, as an accelerometer and a gyro fixed in it would read; the ten
  inertial parameters of a body, and the wrench regressor (section 6.2 c).
- `serial_chain`: the one chain of hinges and slides, built from a description: poses, Jacobian,
  Newton-Euler, mass matrix.
- `arm_inverse`: closed-form inverse of an arm of a yaw and three pitches, for camera and gripper.
"""
