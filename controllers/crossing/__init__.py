"""Crossing a field: two rovers, dropped metres away, search, map and drive to their places.

In reading order:

- `site`: the drawing of the site, and what is known of the initial poses.
- `knowledge`: what one rover believes, of itself and of the site.
- `navigator`: where a rover is, what stands on the ground about it, and how it drives around that.
- `behaviours`: poses and drives, of which the stages are made.
- `search`: the stage in which a rover finds the panel (sections 3.2.2 to 3.2.4).
- `go_to`: the stages in which a rover drives to its place and localizes itself there.
- `map`: the stage in which the master maps the site (section 3.2.3).
- `rover`: one rover's part, stage after stage.
- `team`: both rovers, joined by what they exchange; the controller that the loop runs.
"""
