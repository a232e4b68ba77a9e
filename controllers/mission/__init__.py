"""The mission: two rovers insert a card by their own estimates, chapters 2 to 5 in one run.

In reading order:

- `site`: the drawing of slot, panel, card and initial poses; roles of the rovers.
- `belief`: estimates of one robot.
- `exchange`: all that passes between the robots.
- `stages`: one file for each stage.
- `robot_mission`: one robot's part, stage after stage.
- `team`: joins both parts; the controller that the loop runs.
"""
