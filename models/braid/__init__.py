"""BRAID, stages of bistable legs switched by muscle wires (thesis appendix E).

- `build`: MJCF of any number of stages.
"""
