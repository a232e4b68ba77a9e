"""Planar worlds are mapped, each next view chosen by one of seven methods.

- `planar`: the experiment ``ch3-planar``: figures 3-12 to 3-21 and their metrics.
- `swarm`: the experiment ``ch3-swarm``: one to fifty robots (section 6.2 (d)).
- `worlds`: unstructured and indoor worlds, and worlds from pictures.
- `trial`: one world mapped.
- `explain`: two worked examples, figures 3-6 and 3-8.
- `figures`, `movie`, `record`: figures, a moving picture and a recording.
"""
