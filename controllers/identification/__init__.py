"""Identification of a rover's parameters (Thesis chapter 2 and section 6.2).

The compliant base under its moving arm, chapter 2:

- `parameters`: the 22 unknowns, their prior and their ranges.
- `arm_motion`: limits, excitations and trajectories of the arm.
- `compliant_base`: forward model with sensitivities (appendix B.1).
- `linear_estimators`: A x = F, pseudo-inverse and Kalman filter (eqs 2-1, B-4, section 2.3).
- `output_error`: fit of the forward model to the measured outputs.
- `information`: bits known of each parameter, and identifiability (section 2.6.1).
- `excitation`: choice of the next excitation by a criterion (eq. 2-13).
- `identifier`: excitation and estimation in turns, on the simplified plant.
- `pitch_model`: a rover's pitch under its arm, and what its inclinometer shows (section 2.6.2).
- `swing_plane`: the same for its roll, with the arm turned aside and the centre joint's angle.
- `pitch`, `rover_identifier`: fit, excitation and doubts on the rover, in its pitch or roll alone.

The arm on known ground, section 6.2:

- `arm_sensing`: log of a run, and joint and base motion from it.
- `payload`: what the gripper holds (section 6.2 c).
- `friction`: friction under the wheels and onset of slip (section 6.2 b).

Any robot's model: `any_model`.
"""

# Names of the excitations, apart from what they do: options need no more.

PLANT_CRITERIA = (
    "information",
    "literal",
    "condition",
    "condition_scaled",
    "d_optimal",
    "a_optimal",
)
"""Criteria by which the simplified plant's next excitation is chosen; `excitation.CRITERIA`."""
ROVER_CRITERIA: tuple[str, ...] = ("information", "d_optimal", "a_optimal")
"""Criteria by which the complete rover's next excitation is chosen; `pitch.CRITERIA`."""
EXCITATIONS = ("constant", "random", *PLANT_CRITERIA)
"""Excitations of the simplified plant."""
ROVER_EXCITATIONS = ("constant", "random", *ROVER_CRITERIA)
"""Excitations of the complete rover."""
