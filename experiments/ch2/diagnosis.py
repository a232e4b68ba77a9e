"""``ch2-diagnosis``: a robot names what changed on it, by one identification and spinning wheels.

Each seed makes a robot within its drawing's tolerances and puts it on rough ground. It is as made,
or it carries a box of 1 kg on its rear deck, or its springs have half their stiffness, or one tyre
has half its friction. It swings its arm, again more gently if the identification is in doubt, then
spins each wheel alone. The controllers know the drawing, and how unchanged robots scatter about it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from matplotlib.figure import Figure

from controllers.identification.pitch import NAMES, PitchEstimate
from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from controllers.sensing.diagnosis import (
    NOTICED,
    Finding,
    base_changes,
    beyond_drawing,
    noticed,
    tyre_changes,
)
from controllers.sensing.wheel_grip import WheelGripProbe, WheelGrips
from experiments.ch2.diagnosis_options import Options
from experiments.ch5 import insertion_scene
from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models import as_made
from models.compose import WHEELS, RobotPlacement, load_part
from twin.connect import Connection, connect
from twin.describe import describe_rover
from twin.loop import run as run_loop
from twin.realism import make_robots

ROBOT = "rover1"
FIELD = dataclasses.replace(
    insertion_scene.FIELD, size=(3.0, 3.0), rocks=50, texture_pixels=16, friction=None
)
"""Ground as rough and stony as the insertion's and the mission's; each robot has its own tyres."""
Case = Literal["unchanged", "load", "springs", "tyre"]
CASES: tuple[Case, ...] = get_args(Case)
WORDS = {"load": "load on the base", "springs": "soft springs", "tyre": "worn tyre"}
PAYLOAD = 1.0  # [kg]
PLACES = ((-0.03, 0.03), (-0.16, -0.06))  # Ranges of the box's centre on the rear deck [m].
WEAKER = 0.5  # Stiffness, and friction of one tyre, over that when made.
DETECTED, FALSE_ALARMS = 0.9, 0.05
_LONGEST = 20.0  # Longest time for the wheels [s].


@dataclasses.dataclass(frozen=True)
class DiagnosisTrial:
    """One robot to diagnose.

    Attributes:
        case: What happened to it.
        seed: Random seed of robot, ground, sensors and change.
        robot: Robot to connect to, as `twin.connect.connect` takes it.
    """

    case: Case
    seed: int
    robot: str = "sim"

    @property
    def placement(self) -> RobotPlacement:
        """Robot as made, and changed."""
        (robot,) = make_robots([RobotPlacement(ROBOT)], "default", self.seed)
        assert robot.made is not None
        rng = np.random.default_rng([self.seed, 1])
        x, y = (float(rng.uniform(*span)) for span in PLACES)
        changes = {
            "unchanged": as_made.Change(),
            "load": as_made.Change(payload=PAYLOAD, payload_place=(x, y)),
            "springs": as_made.Change(springs=WEAKER),
            "tyre": as_made.Change(worn_wheel=str(rng.choice(WHEELS)), grip=WEAKER),
        }
        return dataclasses.replace(
            robot, made=dataclasses.replace(robot.made, change=changes[self.case])
        )


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What a robot found out about itself.

    Attributes:
        trial: The robot.
        wheel: Name of the wheel whose tyre has worn; empty if none has.
        estimate: Identification of how it pitches.
        doubts: Why that is not used; none if it is.
        grips: Friction under each wheel.
        changes: What may have changed; base and springs only from an identification without doubts.
    """

    trial: DiagnosisTrial
    wheel: str
    estimate: PitchEstimate
    doubts: tuple[str, ...]
    grips: WheelGrips
    changes: tuple[Finding, ...]

    @property
    def named(self) -> str:
        """Name of the change that is told; empty if none is."""
        change = noticed(self.changes)
        return change.name if change is not None else ""

    @property
    def right(self) -> bool:
        """Whether it tells what happened, and the right wheel."""
        if self.trial.case == "unchanged":
            return not self.named
        return self.named == f"{WORDS[self.trial.case]} {self.wheel}".strip()

    def deviations(self, word: str) -> float:
        """Return how far a change is from chance; NaN if nothing can be said."""
        return next((c.deviations for c in self.changes if c.name.startswith(word)), float("nan"))


def run(options: Options, output: Output) -> None:
    """Diagnose robots of every case, and score.

    Args:
        options: ``quick`` takes 1 robot of each case instead of 20, and of unchanged ones three
            times as many.
        output: Receives ``change_named_fraction/<case>`` and ``false_alarm_fraction``.
    """
    seeds = options.job_seeds(20, 1)
    count = len(seeds)
    more = np.random.SeedSequence([options.seed, 1]).generate_state(2 * count).tolist()
    robots = {case: [*seeds, *more] if case == "unchanged" else seeds for case in CASES}
    trials = [DiagnosisTrial(case, seed, options.robot) for case in CASES for seed in robots[case]]
    results = sweep(diagnose, trials, options, output, label="robots")
    _measure(results, output)
    output.table("diagnoses", *_table(results))
    usual = [r.estimate.parameters for r in results if r.trial.case == "unchanged"]
    drawn = describe_rover(ROBOT)
    output.table("unchanged", NAMES, [beyond_drawing(each, drawn).tolist() for each in usual])
    output.figure("changes", _figure(results))


def diagnose(trial: DiagnosisTrial) -> Diagnosis:
    """Let one robot identify itself, spin its wheels, and say what changed."""
    drawn, placement = describe_rover(ROBOT), trial.placement
    assert placement.made is not None
    config = RoverIdentifierConfig(ROBOT, SwingingArm.of(drawn))
    ground = int(np.random.default_rng([trial.seed, 2]).integers(2**31))
    field = dataclasses.replace(FIELD, seed=ground)
    with connect(
        trial.robot, robots=[placement], field=field, realism="default", seed=trial.seed
    ) as connection:
        estimate = _identified(connection, config, np.random.default_rng([trial.seed, 3]))
        probe = WheelGripProbe(drawn)
        run_loop(
            connection.robots, [probe], connection.clock, [], _LONGEST, until=lambda: probe.done
        )
    grips, doubts = probe.estimate(), estimate.doubts(config.prior)
    base = () if doubts else base_changes(estimate.parameters, drawn)
    changes = (*base, *tyre_changes(grips, drawn))
    return Diagnosis(trial, placement.made.change.worn_wheel, estimate, doubts, grips, changes)


def _identified(
    connection: Connection, config: RoverIdentifierConfig, rng: np.random.Generator
) -> PitchEstimate:
    """Return an identification, repeated as the mission repeats one that is in doubt."""
    identifier = RoverIdentifier(config, rng)
    while True:
        run_loop(connection.robots, [identifier], connection.clock, [], config.total)
        estimate = identifier.finish()
        if not (estimate.doubts(config.prior) and identifier.repeat()):
            return estimate


def _measure(results: Sequence[Diagnosis], output: Output) -> None:
    for case in CASES:
        rights = success_fraction(each.right for each in results if each.trial.case == case)
        if case != "unchanged":
            output.measure(f"change_named_fraction/{case}", rights)
            least = f">= {DETECTED:g}"
            output.check(f"{case} named", rights["mean"], least, rights["mean"] >= DETECTED)
    unchanged = [each for each in results if each.trial.case == "unchanged"]
    alarms = success_fraction(bool(each.named) for each in unchanged)
    output.measure("false_alarm_fraction", alarms)
    most = f"<= {FALSE_ALARMS:g}"
    output.check("false alarms", alarms["mean"], most, alarms["mean"] <= FALSE_ALARMS)
    output.measure("identified_fraction", success_fraction(not each.doubts for each in results))
    errors = [abs(error) for each in results for error in _grip_errors(each)]
    output.measure("wheel_friction_error_percent", distribution(errors))


def _grip_errors(result: Diagnosis) -> list[float]:
    """Return the error of each measured wheel's friction [%]."""
    made, spec = result.trial.placement.made, load_part("rover")
    assert made is not None
    as_made.alter_rover(spec, made)
    true = np.array([spec.geom(f"{wheel}_tyre").friction[0] for wheel in WHEELS])
    errors = 100.0 * (result.grips.friction / true - 1.0)
    return errors[np.isfinite(errors)].tolist()


def _table(results: Sequence[Diagnosis]) -> tuple[list[str], list[list[object]]]:
    columns = ["case", "seed", "wheel", "named", "size", "standard deviation"]
    columns += [f"{word} [deviations]" for word in WORDS.values()]
    columns += [f"friction {wheel}" for wheel in WHEELS]
    rows: list[list[object]] = []
    for each in results:
        change = noticed(each.changes)
        row = [each.trial.case, each.trial.seed, each.wheel, each.named]
        row += [None, None] if change is None else [change.size, change.sigma]
        row += [each.deviations(word) for word in WORDS.values()]
        rows.append([*row, *each.grips.friction, "; ".join(each.doubts)])
    return [*columns, "identification not used because"], rows


def _figure(results: Sequence[Diagnosis]) -> Figure:
    """Draw how far every robot is from unchanged ones, change by change."""
    figure = Figure(figsize=(9, 5))
    axes = figure.add_subplot()
    for index, case in enumerate(CASES):
        chosen = [each for each in results if each.trial.case == case]
        for shift, word in zip((-0.2, 0.0, 0.2), WORDS.values()):
            values = [each.deviations(word) for each in chosen]
            places = index + shift + np.linspace(-0.07, 0.07, len(values))
            label = word if index == 0 else None
            colour = f"C{list(WORDS.values()).index(word)}"
            axes.plot(places, values, ".", color=colour, label=label)
    axes.axhline(NOTICED, color="k", linestyle="--", linewidth=0.8, label="named from here")
    axes.set_xticks(range(len(CASES)), [WORDS.get(case, case) for case in CASES])
    axes.set_ylabel("distance from unchanged robots [standard deviations]")
    axes.set_xlabel("what happened to the robot")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure
