"""A twin that runs beside a robot: predicted with what was applied, corrected by what was measured.

In reading order:

- `deviations`: ways in which a rover may differ from its drawing, each by one number.
- `readings`: what a rover's channels read, from the states of many models at once.
- `gain`: how far a measurement corrects the twin's state.
- `ground`: the slope of even ground, by what a twin that drives takes for it.
- `shadow`: the twin, and how much each deviation would change what it expects.

It is given the drawing, observations and applied commands, and nothing else of the robot.
"""
