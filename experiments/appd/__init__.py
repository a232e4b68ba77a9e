"""The rover's hardware (appendix D).

- `calibration`: the inclinometers, weighed on a tilting table (Table D-1).
- `boards`: the motor boards with their faults, and the loop at 100 Hz (figure D-3).
- `radio`: the handshake between robots, beside a link in frames.
"""
