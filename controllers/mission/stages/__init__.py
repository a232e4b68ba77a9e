"""Stages of a mission, one file each, in their order.

- `identify`: each robot swings its arm and finds how it pitches on its springs (chapter 2).
- `find`: the master finds the panel and begins the map (sections 3.2.2, 3.2.3).
- `meet`: the master finds the card; the slave learns how it turns and where the slot is.
- `map`: both map the place together (sections 3.2.4, 3.2.5).
- `place`: the master drives to the best camera station (chapter 4).
- `insert`: the master guides, the slave inserts the card (chapter 5).
- `rest`: what a robot does in a stage in which it has no part.
"""
