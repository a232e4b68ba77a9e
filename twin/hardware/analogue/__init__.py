"""Analogue inputs of a board that runs StandardFirmata (thesis appendix D).

- `firmata_codec`: messages of the protocol as bytes, and back.
- `firmata`: the client on a serial port.
"""
