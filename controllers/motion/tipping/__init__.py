"""What tips a rover over, and how it is kept from that (Thesis section A.3).

In reading order:

- `tip_over`: the zero-moment point (eq. A-5), and motions that keep it within the footprint.
- `online_guard`: a motion that is slowed tick by tick.
- `rocking`, `look_ahead`: how likely a planned motion tips the rover over, or lets it slide.
- `tip_guard`: both together, for a mission's moves and drives.
- `guarded_swing`: a swing of the arm under one of these guards, or under none.
- `foreseen_motion`: a swing or a drive as planned, and how likely that was held to be.
"""
