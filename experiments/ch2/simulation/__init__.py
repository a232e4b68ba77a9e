"""The simplified rover identifies its 22 parameters (section 2.6.1).

- `simulation`: the experiment: its options, and the order of its parts.
- `truths`: true parameters: Table 2-1's, a user's own, or random ones.
- `plant`: the rover on springs in MuJoCo, and the noise on its measurements.
- `trial`: one identification, compared with the truth.
- `verification`: that the plant obeys its equations, and what poor experiments leave unknown.
- `results`: metrics, checks and Table 2-1.
- `figures`, `record`: figures 2-4 to 2-7, and a recording.
"""
