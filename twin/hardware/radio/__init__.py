"""The radio between two robots at 9600 baud (thesis appendix D).

- `channel`: byte channel between a computer and its modem.
- `frames`: encoding and decoding of frames with a checksum.
- `framed_radio`: link of the robots (`twin.link`).
- `handshake`: protocol of the thesis, as the reference.
"""
