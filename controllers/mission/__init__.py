"""The mission: two rovers, dropped metres away, find their site and insert a card together.

In reading order:

- `config`: its stages, and what can be left out.
- `site`: the drawing of slot, panel and card, and what is known of initial poses; the roles.
- `belief`: estimates of one rover.
- `navigator`: where a rover is, what stands on the ground about it, and how it drives around that.
- `behaviours`: poses and drives, of which stages are made.
- `stage`: what every stage has, and how one fails.
- `stages`: the stages themselves.
- `radio`: one rover's end of the radio: all that passes between the rovers.
- `map_exchange`: what both have mapped of the ground, exchanged.
- `robot_mission`: one rover's part, stage after stage.
- `team`: both rovers' parts; the controller that the loop runs.
"""
