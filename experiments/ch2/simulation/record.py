"""One identification of the simplified rover as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from controllers.identification.arm_motion import MODES
from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.parameters import NAMES, UNITS
from experiments.ch2.simulation.trial import PlantIdentification
from twin.loop import Tick
from twin.recording.layout import side_by_side
from twin.recording.record import Recorder

BAND = 2.0
"""Half width of the recorded bands, in standard deviations."""


def layout() -> rrb.Blueprint:
    """Return the arm's swing and its excitation, beside the estimates, a view for each unit."""
    swing = rrb.TimeSeriesView(origin="excitation/arm_angle", name="Arm [rad]")
    modes = [
        rrb.TimeSeriesView(origin=f"excitation/{mode}", name=f"{mode}: offset, amplitude, rate")
        for mode in MODES
    ]
    estimates = [
        rrb.TimeSeriesView(
            origin="estimates",
            contents=[f"$origin/{name}/**" for name, each in zip(NAMES, UNITS) if each == unit],
            name=f"{', '.join(n for n, each in zip(NAMES, UNITS) if each == unit)} [{unit}]",
        )
        for unit in dict.fromkeys(UNITS)
    ]
    excitation = rrb.Vertical(swing, *modes, row_shares=[2, 1, 1, 1])
    return side_by_side(rrb.Grid(*estimates, grid_columns=2), excitation)


def record_trial(trial: PlantIdentification, path: Path) -> None:
    """Write the arm's swing, the excitation and the estimates with their bands.

    Args:
        trial: Result of one trial; its angles are thinned evenly.
        path: File to write.
    """
    angles = trial.arm_angles
    windows = len(trial.histories["ours"])
    per_window = angles.shape[1] // windows
    with Recorder(path, blueprint=layout()) as recorder:
        for window in range(windows):
            start = window * REPLAN_PERIOD
            for sample in range(per_window):
                step = window * per_window + sample
                time = start + sample * REPLAN_PERIOD / per_window
                recorder.record(Tick(step, time, {}, {}))
                recorder.log_scalars("excitation/arm_angle", angles[:, step], MODES)
            for index, mode in enumerate(MODES):
                values = trial.excitation_history[window][index]
                names = ("offset", "amplitude", "frequency")
                recorder.log_scalars(f"excitation/{mode}", values, names)
            mean, sigma = trial.histories["ours"][window], trial.sigma_history[window]
            for index, name in enumerate(NAMES):
                value, half = float(mean[index]), BAND * float(sigma[index])
                if np.isfinite(half):
                    recorder.log_band(f"estimates/{name}", value, value - half, value + half)
