"""The inclinometers are calibrated by weighing (Table D-1).

- `calibration`: the experiment ``appd-calibration``: fits, metrics and the table.
- `tilt_table`: a robot weighed on a tilting table.
"""
