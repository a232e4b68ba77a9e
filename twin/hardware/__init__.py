"""The robot over real boards: codecs, clients, calibration, and the same boards emulated."""
