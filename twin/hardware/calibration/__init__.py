"""Counts of one particular robot into SI units and back, from TOML files (thesis table D-1).

- `section`: base of all sections of a file.
- `motors`, `sensors`: the sections of the boards.
- `calibration`: the whole file, read, checked and written.
- `tilt_fit`: inclinometer constants from weighings on wedges.
- `procedure`: steps through which a person calibrates the inclinometer.
"""
