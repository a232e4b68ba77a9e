"""Commands for people.

- `calibrate`: calibrates a real robot's inclinometer (appendix D).
"""
