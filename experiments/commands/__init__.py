"""Commands for people.

- `calibrate`: calibrates a real robot's inclinometer (appendix D).
- `truth_template`: prints a file for `ch2-simulation --truth`.
"""
