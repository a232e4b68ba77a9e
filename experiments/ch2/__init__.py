"""Identification of the rover's own dynamics (chapter 2), and of payload and ground (section 6.2).

- `simulation`: the simplified rover of section 2.6.1 (Table 2-1, figures 2-4 to 2-7).
- `rover`: the complete rover of section 2.6.2 (Table 2-2, figures 2-9 to 2-12).
- `payload`: an unknown mass in the gripper (section 6.2 (c)).
- `friction`: the friction under the wheels (section 6.2 (b)).
"""
