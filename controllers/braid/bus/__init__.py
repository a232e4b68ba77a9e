"""Two-wire bus of the binary arm (Thesis section E.4), in reading order.

- `code`: addresses as numbers of pulses. `trains`: pulse trains and their faults.
- `decoder_chips`, `circuit`: line and decoders, sampled. `master`: protocols.
- `drive`: open-loop drive of the muscle wires.
"""
