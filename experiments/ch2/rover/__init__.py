"""The complete rover identifies its pitch dynamics (section 2.6.2).

- `rover`: the experiment: options, metrics, Table 2-2, figures 2-9 to 2-12 and a recording.
- `laboratory`: the true values, measured on the model as in a laboratory.
- `trial`: one identification through the robot contract.
- `confidence`: errors beside the laboratory, coverage, and false confidence.
- `roll`: errors of roll, with and without the centre joint's potentiometer.
- `movie`: a moving picture.
"""
