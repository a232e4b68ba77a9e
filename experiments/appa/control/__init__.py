"""The arm's control laws on soft, middle and stiff bases (figure A-1, equations A-1 to A-4).

- `control`: the experiment ``appa-control``: options, metrics and figures.
- `plant`: the nine coordinates in MuJoCo, and rovers on other springs.
- `trial`: one run: the arm follows its reference while its base is pushed.
"""
