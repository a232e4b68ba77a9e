"""Chapter 5: insertion of a card, by two rovers and on a bench.

Two rovers (``ch5-insertion``, Table 5-1, figures 5-11 to 5-14):

- `insertion`: measures and checks; its options beside it.
- `insertion_scene`, `insertion_setting`, `insertion_faults`: scene, robots and their faults.
- `insertion_identify`: drive in which a rover identifies its slip.
- `insertion_trial`: one insertion, scored by the truth.
- `insertion_figures`, `insertion_film`, `task_film`: figures, and pictures and recordings.

Beside them:

- `contact`: a bench (``ch5-contact``, figures A-5 to A-7).
- `marker_scene`: card and slot before a free stereo head, for the marker detectors.
"""
