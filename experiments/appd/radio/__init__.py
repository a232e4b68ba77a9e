"""The radio between two rovers.

- `radio`: the experiment ``appd-radio``: metrics and checks; its options beside it.
- `trial`: messages one way over an emulated radio, in virtual time.
- `demo`: two rovers drive and share their poses.
- `figures`: the figures.
"""
