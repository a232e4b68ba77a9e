"""BRAID in physics.

- `mechanism`: the experiment ``appe-mechanism``: metrics and checks; its options beside it.
- `bench`: an arm of some stages in MuJoCo, driven by its muscle wires.
- `trial`: settled states, detents, sag, and words in sequence.
- `figures`: figures E-1, E-2 and E-9.
- `record`: a recording of words, and of what an arm does in any scene.
"""
