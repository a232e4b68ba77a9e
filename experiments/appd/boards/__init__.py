"""The rover through emulated boards (figure D-3).

- `boards`: the experiment ``appd-boards``: metrics and checks; its options beside it.
- `trial`: one fault injected into a rover in motion.
- `matrix`: every fault in every state, with boards on their own clock.
- `host`: the program that drives the robot in the matrix, and is killed.
- `soak`: hours of driving with faults, faster than real time.
- `line`: calls over a line that damages exchanges.
- `live`: boards compared with the rover without wires, and the loop in real time.
- `echo_probe`: a process that echoes, the least that boards behind a port can cost.
- `figures`: the figures.
"""
