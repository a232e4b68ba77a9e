"""The radio between two robots at 9600 baud (thesis appendix D).

- `channel`: the line between a computer and its modem.
- `frames`: messages as bytes with a checksum, and back.
- `framed_radio`: the link that robots use (`twin.link`).
- `handshake`: the thesis' own protocol, kept as the reference.
"""
