"""All experiments and commands by name; modules are imported only when needed."""

import dataclasses
import importlib
from collections.abc import Callable
from typing import Any


@dataclasses.dataclass(frozen=True)
class Command:
    """A command's entry in the catalogue.

    The module holds a function ``run``. Its options are a frozen dataclass ``Options`` in a module
    of their own, which imports no simulator, so that help appears at once. Both are imported only
    when the command is needed.

    Attributes:
        name: Name on the command line.
        summary: One line for the list.
        module: Import path of the module.
        example: Words behind the name that its help shows as an example.
        options: Import path of that of the options; empty for `module` with ``_options`` behind it.
    """

    name: str
    summary: str
    module: str
    example: str = dataclasses.field(kw_only=True)
    options: str = dataclasses.field(default="", kw_only=True)

    def options_type(self) -> type[Any]:
        """Import the module of the options and return their type."""
        return importlib.import_module(self.options or f"{self.module}_options").Options

    def load(self) -> Callable[..., Any]:
        """Import the module and return its function ``run``.

        A command's takes the options and returns the exit status; an experiment's takes the options
        and its `Output`.
        """
        return importlib.import_module(self.module).run


@dataclasses.dataclass(frozen=True)
class Experiment(Command):
    """An experiment's entry: a command that writes results to a folder of its name.

    Its options are derived from `contract.Options`.

    Attributes:
        thesis: The thesis element that it reproduces, for instance "Table 2-1, figures 2-4, 2-5".
        full: About how long a full run takes on two cores, measured or by the time of a part of it;
            empty if neither is known.
        quick: How long a quick run takes.
    """

    thesis: str
    full: str = dataclasses.field(default="", kw_only=True)
    quick: str = dataclasses.field(default="less than a minute", kw_only=True)


_ALL: tuple[Experiment, ...] = (
    Experiment(
        name="ch2-simulation",
        summary="the simplified rover identifies itself by swinging its arm",
        thesis="Table 2-1, figures 2-4 to 2-7",
        module="experiments.ch2.simulation.simulation",
        example="--excitations constant information --seeds 20",
        full="two hours",
    ),
    Experiment(
        name="ch2-rover",
        summary="the complete rover identifies how it pitches, by inclinometer and arm wrench",
        thesis="Table 2-2, figures 2-9 to 2-12",
        module="experiments.ch2.rover.rover",
        example="--robot emulated --axis roll --seeds 3",
        full="4 minutes",
    ),
    Experiment(
        name="ch2-payload",
        summary="an unknown payload is identified by swinging the arm that holds it",
        thesis="section 6.2 (c), suggested only",
        module="experiments.ch2.payload",
        example="--duration 20 --robot quantised",
        full="6 minutes",
    ),
    Experiment(
        name="ch2-friction",
        summary="the arm's jerks show the friction under the wheels and when they slip",
        thesis="section 6.2 (b), suggested only",
        module="experiments.ch2.friction",
        example="--realism harsh",
        full="3 minutes",
    ),
    Experiment(
        name="ch2-diagnosis",
        summary="a load, soft springs or a worn tyre is named after one identification",
        thesis="chapter 2, beyond it",
        module="experiments.ch2.diagnosis",
        example="--seeds 5 --seed 71",
        full="7 minutes",
    ),
    Experiment(
        name="ch3-planar",
        summary="planar worlds are mapped, each next view chosen by any of seven methods",
        thesis="figures 3-6, 3-8, 3-12 to 3-21",
        module="experiments.ch3.planar.planar",
        example="--world plan.png --pixel 0.05 --methods max_new information",
        full="12 minutes",
    ),
    Experiment(
        name="ch3-stereo",
        summary="two rovers map a cluttered field with stereo heads on their arms",
        thesis="figures 3-22 to 3-27, section 6.2 (a)",
        module="experiments.ch3.stereo.stereo",
        example="--parts mapping --scans 6 --record",
        full="10 minutes",
    ),
    Experiment(
        name="ch3-swarm",
        summary="one to fifty robots map an indoor world together",
        thesis="section 6.2 (d), suggested only",
        module="experiments.ch3.planar.swarm",
        example="--robots 1 5 20",
        full="9 minutes",
    ),
    Experiment(
        name="ch4-planar",
        summary="cameras are placed on the plane, and watch a panel on its way to the target",
        thesis="figures 4-6, 4-8, 4-10, 4-11",
        module="experiments.ch4.planar.planar",
        example="--rings 32 --factor 1.5",
        full="3 minutes",
    ),
    Experiment(
        name="ch4-montecarlo",
        summary="a camera guides an object to its goal among obstacles, placed by three methods",
        thesis="Table 4-1",
        module="experiments.ch4.montecarlo.montecarlo",
        example="--seeds 100",
        full="1 minute",
    ),
    Experiment(
        name="ch4-stereo",
        summary="a camera is placed among blocks in space, and what it sees is rendered",
        thesis="figures 4-12, 4-13",
        module="experiments.ch4.spatial.stereo",
        example="--scenes 50 --target hole1",
        full="3 minutes",
    ),
    Experiment(
        name="ch5-insertion",
        summary="two rovers insert a card: the master watches, the slave brings it",
        thesis="chapter 5, Table 5-1, figures 5-11 to 5-14",
        module="experiments.ch5.insertion",
        example="--parts guides --seed 7227",
        full="an hour",
    ),
    Experiment(
        name="ch5-contact",
        summary="a card is inserted by what the hand feels, and contact states are classified",
        thesis="figures A-5 to A-7, section 5.4 (forces)",
        module="experiments.ch5.contact.contact",
        example="--realism harsh --seed 6006",
        full="6 minutes",
    ),
    Experiment(
        name="mission",
        summary="two rovers dropped in a field find their site, map it and insert a card",
        thesis="figure 1-5, chapters 2 to 5 together",
        module="experiments.mission.mission",
        example="--seeds 10 --without paths",
        full="three hours",
        quick="four minutes",
    ),
    Experiment(
        name="mission-envelope",
        summary="what each kind of knowledge is worth to insertion and mission, and where nothing",
        thesis="the thesis' claim: what knowledge of oneself and one's surroundings brings",
        module="experiments.envelope.envelope",
        example="--axes clearance slope --resume",
        full="a day",
    ),
    Experiment(
        name="appa-control",
        summary="the arm's control laws on soft, middle and stiff bases that are pushed",
        thesis="figure A-1, equations A-1 to A-4",
        module="experiments.appa.control.control",
        example="--seeds 2",
        full="2 minutes",
    ),
    Experiment(
        name="appa-tipover",
        summary="arm motions that would tip the rover are slowed or cut short",
        thesis="figure A-4, equation A-5",
        module="experiments.appa.tipover.tipover",
        example="--seeds 3",
        full="2 minutes",
    ),
    Experiment(
        name="appa-truss",
        summary="two rovers hold one segment and insert it in a truss stage, master and slave",
        thesis="figures A-8 to A-12",
        module="experiments.appa.truss.truss",
        example="--seeds 4",
        full="4 minutes",
    ),
    Experiment(
        name="appc-compression",
        summary="pictures are compressed in ten ways, and their information chooses views",
        thesis="Table C-1, figure C-2",
        module="experiments.appc.compression",
        example="--views 10",
        full="3 minutes",
    ),
    Experiment(
        name="appd-calibration",
        summary="the inclinometers are calibrated by weighing on a tilting table",
        thesis="Table D-1",
        module="experiments.appd.calibration.calibration",
        example="--seeds 8",
        full="3 minutes",
    ),
    Experiment(
        name="appd-boards",
        summary="the rover through emulated boards with all their faults, and at 100 Hz",
        thesis="figure D-3",
        module="experiments.appd.boards.boards",
        example="--parts matrix",
        full="4 minutes",
    ),
    Experiment(
        name="appd-radio",
        summary="the thesis' radio handshake beside a link in frames, under byte errors",
        thesis="appendix D, inter-robot communication",
        module="experiments.appd.radio.radio",
        example="--delay 0.02",
        full="1 minute",
    ),
    Experiment(
        name="appe-workspace",
        summary="all words of five BRAID stages, the poses they reach, and the stage itself",
        thesis="figure E-5, equations E-1 to E-34",
        module="experiments.appe.arm.workspace",
        example="--stages 4 --extension 0.25",
        full="5 seconds",
    ),
    Experiment(
        name="appe-inverse",
        summary="words of a binary arm for target poses by seven searches, also among obstacles",
        thesis="section E.3.2",
        module="experiments.appe.arm.inverse",
        example="--targets 100",
        full="12 minutes",
    ),
    Experiment(
        name="appe-mechanism",
        summary="BRAID in physics: settled states, detents, sag, and words by its muscle wires",
        thesis="figures E-1, E-2, E-9",
        module="experiments.appe.mechanism.mechanism",
        example="--stages 3 --words 50",
        full="4 minutes",
    ),
    Experiment(
        name="appe-placement",
        summary="a camera placement that BRAID takes on a rover, seen by what is rendered then",
        thesis="appendix E with chapter 4, suggested only",
        module="experiments.appe.placement.placement",
        example="--stages 3 --seeds 5",
        full="5 minutes",
    ),
    Experiment(
        name="appe-bus",
        summary="pulses on BRAID's power line address its actuators, despite noise and lost pulses",
        thesis="figures E-7, E-8",
        module="experiments.appe.bus.bus",
        example="--seed 1",
        full="4 minutes",
    ),
    Experiment(
        name="own-robot",
        summary="robots that nobody is told, identified by motions designed for them",
        thesis="section 2.6, on any robot",
        module="experiments.own.hidden.own_robot",
        example="--robots leg cart --count 5 --compared 2 --peer 0 --rovers 0",
        quick="a minute",
        full="five hours",
    ),
    Experiment(
        name="living-twin",
        summary="what a twin beside a rover notices, by name, size and delay, and what it foresees",
        thesis="beyond the thesis",
        module="experiments.living.living_twin",
        example="--seeds 3 --learning 60 --unchanged 600",
        full="30 hours",
    ),
    Experiment(
        name="bench",
        summary="speed and accuracy measured against a named peer in the same run",
        thesis="beyond the thesis",
        module="experiments.bench.bench",
        example="--only loop mapping",
        full="40 minutes",
    ),
)

EXPERIMENTS: dict[str, Experiment] = {experiment.name: experiment for experiment in _ALL}

COMMANDS: dict[str, Command] = {
    command.name: command
    for command in (
        Command(
            "view",
            "a scene to look at, drive and push, in MuJoCo's viewer or the browser",
            "experiments.live.view",
            example="mission --browser --port 8080",
        ),
        Command(
            "drive",
            "a person drives a rover and moves its arm, on a page that shows both its eyes",
            "experiments.live.drive",
            example="--speed 0.3 --record drive.rrd",
        ),
        Command(
            "live",
            "the twin beside a rover, owned or told of by a log: what it deviates by, what changed",
            "experiments.live.live",
            example="--robot emulated --live",
        ),
        Command(
            "doctor",
            "versions, renderer, and what is missing on this machine",
            "experiments.doctor.doctor",
            example="--robot emulated",
        ),
        Command(
            "calibrate",
            "a person calibrates a real robot's inclinometer by weighing it on wedges (Table D-1)",
            "experiments.commands.calibrate",
            example="--robot serial:/dev/ttyUSB0,analogue=/dev/ttyACM0,wrench=192.168.1.1",
        ),
        Command(
            "truth-template",
            "a file for ch2-simulation --truth: names, units and Table 2-1's values",
            "experiments.commands.truth_template",
            example="> truth.toml",
        ),
        Command(
            "log",
            "what a log of any robot holds (CSV, MCAP, rosbag2, LeRobot), and what is wrong in it",
            "experiments.commands.log",
            example="run.mcap --mapping robot.toml",
        ),
        Command(
            "identify",
            "the parameters of any MuJoCo model from logs of its robot, with bands and a verdict",
            "experiments.own.identify",
            example="--model robot.xml --log a.mcap --hold-out b.mcap --parameters joint.*",
        ),
        Command(
            "excite",
            "the motion that tells most of a MuJoCo model's parameters, within limits",
            "experiments.own.excite",
            example="--model robot.xml --parameters joint.* --limits limits.toml --out motion.csv",
        ),
        Command(
            "play",
            "a rover of ours follows a motion with its arm, and all that it measures is logged",
            "experiments.own.play",
            example="--motion motion.csv --robot emulated --log run.mcap",
        ),
        Command(
            "replay",
            "a log's commands once more in simulation, beside what was measured",
            "experiments.own.replay",
            example="--log run.mcap --model robot.xml --mapping robot.toml",
        ),
        Command(
            "report",
            "all results beside the thesis' in OUT/report.html",
            "experiments.report.report",
            example="--out results",
        ),
        Command(
            "bench-table",
            "the table of docs/benchmarks.md, from OUT/bench",
            "experiments.report.bench_table",
            example="--write docs/benchmarks.md",
        ),
    )
}
