"""Robots over real boards, and the same boards emulated (thesis appendix D).

- `serial_link`: a serial port with deadlines; `background`: threads beside the control loop.
- `roboclaw`: motor boards; `analogue`: inclinometer and centre potentiometer; `force_torque`: the
  sensor under the arm; `cameras`: stereo pairs; `radio`: modems between two robots.
- `calibration`: counts of one particular robot into SI units, and the procedure that finds them.
- `board_set`: all boards of one robot as one device.
- `board_samples`: latest sample of every board, with its age.
- `board_robot`: a robot of the contract (`twin.robot`) over its boards.
- `wiring`: what the words of ``serial:`` say; `connect_boards`: robots from them.
- `emulator`: the same boards on pseudo-terminals, with simulated physics behind them.
"""
