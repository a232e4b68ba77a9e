"""Motion of rovers and their arms (Thesis appendix A and sections 5.2 to 5.3).

- `driving`, `drive_to_pose`: skid steering, dead reckoning, and a drive to a pose.
- `arm_move`: an arm that goes to a posture, and pairs of images taken there at rest.
- `base_motion`: motion of the base as measured.
- `base_tilt`: tilt of the base on its springs under the arm.
- `lagrange`: the nine coordinates of rover and arm, and their state space (eqs A-2, A-3).
- `arm_control`: control of the arm on its yielding base (eq. A-4).
- `tipping`: zero-moment point, guards against tipping over (eq. A-5), and looking ahead.
- `teleoperation`: a person who drives the rover and moves its arm.
- `simple_motions`: motions of all axes that exercise loop, boards and sensors, and work at random.
"""
