"""The plant of the simulation study: an arm on a base on springs (thesis chapter 2).

- `build`: the plant of any parameter set and arm mode.
"""
