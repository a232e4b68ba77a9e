"""Boards that behave as their makers document, with the physics of the twin behind them.

- `ports`: pseudo-terminals.
- `roboclaw_board`, `firmata_board`, `net_ft`: the boards' protocols; `modem`: the radio's modems.
- `amplifier`: the thesis' motor amplifier (thesis figure D-3).
- `faults`: damaged lines and scheduled faults.
- `rover`: what the boards of one rover are wired to; `direct`: the same without wires.
- `scene`: the physics behind all rovers; `drawing`: their stereo pairs from a process of their own.
- `rig`: the boards of one rover on their ports.
- `__main__`: the program that serves them; `process`: starts and steers it from another one;
  `messages`: the messages about its robots.
"""
