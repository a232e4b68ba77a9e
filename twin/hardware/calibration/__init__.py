"""Conversion between the counts of one robot's boards and SI units, from TOML files (Table D-1).

- `section`: base of all sections of a file.
- `motors`, `sensors`: sections of the boards.
- `calibration`: reading, validation and writing of whole files.
- `tilt_fit`: inclinometer constants from weighings on wedges.
- `procedure`: interactive calibration of the inclinometer.
"""
