"""The mission: two rovers insert a card by what they find out, chapters 2 to 5 in one run.

In reading order:

- `site`: the drawing of slot, panel, card and initial poses; who does what.
- `belief`: what one robot believes.
- `exchange`: all that passes between the robots.
- `stages`: one file for each stage.
- `robot_mission`: one robot's part, stage after stage.
- `team`: joins both parts; this is what the loop runs.
"""
