"""The radio between two rovers.

- `radio`: the experiment ``appd-radio``: options, metrics and checks.
- `trial`: messages one way over an emulated radio, in virtual time.
- `demo`: two rovers drive and share their poses.
- `figures`: the figures.
"""
