"""Stages of a mission, in their order.

- `identify`: each rover swings its arm and finds how it pitches on its springs (chapter 2).
- `search`: each rover finds the panel by driving (sections 3.2.2 to 3.2.4).
- `map_site`: the master maps the site (section 3.2.3).
- `go_to`: `place`, in which the master drives to the best camera station (chapter 4), and
  `approach`, in which the slave drives before the slot; and what a rover does in the other's stage.
- `insert`: the master guides, the slave inserts the card (chapter 5).
"""
