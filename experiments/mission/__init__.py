"""The mission of two rovers, chapters 2 to 5 in one run (figure 1-5).

- `mission`: measures and checks; its options beside it.
- `scene`, `trial`: site and drawing; one mission, scored against the truth.
- `collisions`: what rovers touch, and whether they fall, for scoring alone.
- `results`: results of several missions by stage.
- `figures`, `film`: figures, progress bars, pictures and a recording.
"""
