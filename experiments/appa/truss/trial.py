"""One run of ``appa-truss``: two rovers carry a segment to a truss stage and insert it."""

import dataclasses
import math

import numpy as np

from controllers.insertion.cooperation import (
    MASTER_FORCES,
    NO_FORCES,
    SLAVE_FORCES,
    Grip,
    HybridConfig,
    HybridGrip,
)
from controllers.insertion.guide import GuideConfig, InsertionGuide, Phase, StraightInsertion
from controllers.insertion.master_slave import Master, PairConfig, Slave, Stage
from controllers.insertion.planar_grip import GripSensor, PlanarArm, Stance
from controllers.kinematics.serial_chain import SerialChain
from experiments.appa.truss.bench import ROBOTS, TrussBench
from models import datasheets
from models.truss import MASTER, SLAVE, TRUSS
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_choice
from twin.describe import describe_rover
from twin.hardware.emulator.modem import ModemConfig, virtual_links
from twin.simulation import Simulation

PERIOD = 0.01
OFFSET, TILT = 4e-3, math.radians(2.0)
"""Widest misalignment of the stage from the master's prior."""
MUTUAL = 5e-3
"""Widest error of the slave's prior position, along and up [m]."""
ALONG = 0.02
"""Distance of the mouth from the segment's start, along s [m]."""
SQUEEZE = 1.0
"""Wanted force along the segment from both ends [N]."""
SEATED = 0.8
"""Share of the depth that both corners of the leading edge must have reached."""
LIMIT = 45.0
"""Longest run [s]."""
METHODS: dict[str, tuple[bool, bool]] = {
    "hybrid": (True, True),
    "position_only": (False, True),
    "unguided": (True, False),
}
"""Whether the grips control forces, and whether the insertion is guided by them."""

COLUMNS = {
    "contact": slice(3, 5),
    "gripper": slice(5, 11),
    "wrench": slice(11, 17),
    "joints": slice(17, 23),
    "base": slice(23, 29),
    "efforts": slice(29, 35),
    "base_wrench": slice(35, 41),
}
"""Of a course, after time, stage and the segment's planned height: the stage's force on the
segment (2,), then of master and slave (3,) each the gripper's true pose and wrench on the segment,
shoulder, elbow and wrist, the base's pose, the three motors' efforts and the wrench on the arm."""


@dataclasses.dataclass(frozen=True)
class TrussTrial:
    """Parameters of one run.

    Attributes:
        method: Method of insertion, a key of `METHODS`.
        share: Share of the widest misalignment; signs, and sizes from half of it, are drawn.
        seed: Random seed of misalignments, sensors and radio; all methods get the same.
        traced: Whether courses are kept.
        byte_errors: Probability that the radio hits a byte.
    """

    method: str
    share: float
    seed: int
    traced: bool = False
    byte_errors: float = 1e-3


def guide_config() -> GuideConfig:
    """Return the guide's configuration; slower than with one hand, as forces come by radio."""
    return GuideConfig(
        TRUSS.web_width,
        TRUSS.friction,
        datasheets.HAND.stiffness,
        depth=TRUSS.depth,
        speed=0.008,
        give=0.0015,
        give_turn=0.3,
        moment_deadband=0.06,
        filter_time=0.06,
        turn_rate=0.05,
        timeout=38.0,
    )


def planar_arm() -> PlanarArm:
    """Return the arm in its plane, in the robot frame."""
    rover, arm = datasheets.ROVER, datasheets.ARM
    rise = arm.base_height + arm.turret_height
    return PlanarArm(
        (rover.arm_mount[1], rover.arm_mount[2] + rise),
        (arm.upper_length, arm.forearm_length, arm.wrist_length),
    )


def make_pair(
    bench: TrussBench, method: str, mouth: tuple[float, float], mutual: FloatArray
) -> tuple[Master, Slave]:
    """Return both controllers.

    Args:
        bench: Scene with the robots; their true poses stand for those of the map.
        method: Method of insertion, a key of `METHODS`.
        mouth: s, z of the mouth by the master's prior [m].
        mutual: (2,) error of the slave's prior position [m].
    """
    by_force, guided = METHODS[method]
    arm, half = planar_arm(), TRUSS.grip_span / 2.0
    mount = datasheets.ROVER.arm_mount[1:]
    grips: list[HybridGrip] = []
    for name, facing, forces, wrong in (
        (MASTER, 1, MASTER_FORCES, np.zeros(2)),
        (SLAVE, -1, SLAVE_FORCES, mutual),
    ):
        chain = SerialChain.of_robot(describe_rover(name))
        sensor = GripSensor(chain, arm, mount)
        s, z = bench.place(f"{name}/chassis")[:2] + wrong
        config = HybridConfig(
            forces if by_force else NO_FORCES, (-SQUEEZE, 0.0, 0.0), period=PERIOD
        )
        grips.append(HybridGrip(config, arm, sensor, Stance((float(s), float(z)), facing)))
    pair = PairConfig(
        Grip((-half, TRUSS.grip_rise), TRUSS.grip_pitch),
        Grip((half, TRUSS.grip_rise), -TRUSS.grip_pitch),
        mouth,
        guide_config(),
        period=PERIOD,
    )
    guide = InsertionGuide if guided else StraightInsertion
    return Master(grips[0], pair, guide), Slave(grips[1], pair)


@dataclasses.dataclass(frozen=True)
class TrussRun:
    """Result of one insertion of the segment.

    Forces and moments are the true ones between stage and segment and in the grips, at 100 Hz; all
    but the contact's from the start of the approach on.

    Attributes:
        success: Whether it was believed seated, and truly is to `SEATED` of the depth.
        contact_peak: Largest force between stage and segment [N].
        squeeze_peak: Largest force along the segment between the grips [N].
        squeeze_error_rms: R.m.s. of that force's error [N].
        moment_peak: Largest moment in a grip [N m].
        seconds: Duration [s].
        reason: Why the master ended.
        tries: Number of attempts to insert.
        depth: Final depth of the leading edge below the mouth [m].
        offset: True offset of the stage along s [m].
        tilt: True tilt of the stage [rad].
        mutual: (2,) error of the slave's prior position, along and up [m].
        course: (n, 41) the run over time, by `COLUMNS`, if traced.
    """

    success: bool
    contact_peak: float
    squeeze_peak: float
    squeeze_error_rms: float
    moment_peak: float
    seconds: float
    reason: str
    tries: int
    depth: float
    offset: float
    tilt: float
    mutual: FloatArray
    course: FloatArray | None = None


def run_truss(trial: TrussTrial) -> TrussRun:
    """Carry and insert once.

    Raises:
        ValueError: If there is no such method.
    """
    check_choice("method", trial.method, METHODS)
    rng = np.random.default_rng([trial.seed, 20])
    wrong = trial.share * rng.uniform(0.5, 1.0, 4) * rng.choice([-1.0, 1.0], 4)
    offset, tilt, mutual = wrong[0] * OFFSET, wrong[1] * TILT, wrong[2:] * MUTUAL
    bench = TrussBench(ALONG + offset, tilt)
    master, slave = make_pair(bench, trial.method, (ALONG, TRUSS.mouth_height), mutual)
    course = _drive(bench, master, slave, trial, rng)
    depth = bench.depth()
    rows = np.array(course)
    after = rows[rows[:, 1] > list(Stage).index(Stage.HOLD)]
    wrenches = after[:, COLUMNS["wrench"]].reshape(-1, 2, 3)
    squeeze = (wrenches[:, 0, 0] - wrenches[:, 1, 0]) / 2.0
    moments = np.abs(wrenches[:, :, 2])
    contact = rows[:, COLUMNS["contact"]]
    return TrussRun(
        success=bool(master.guide.phase is Phase.DONE and depth > SEATED * TRUSS.depth),
        contact_peak=float(np.max(np.hypot(*contact.T))),
        squeeze_peak=float(np.max(np.abs(squeeze))),
        squeeze_error_rms=float(np.sqrt(np.mean((squeeze - SQUEEZE) ** 2))),
        moment_peak=float(np.max(moments)),
        seconds=float(rows[-1, 0]),
        reason=master.guide.reason,
        tries=master.guide.tries,
        depth=depth,
        offset=offset,
        tilt=tilt,
        mutual=mutual,
        course=rows if trial.traced else None,
    )


def _drive(
    bench: TrussBench, master: Master, slave: Slave, trial: TrussTrial, rng: np.random.Generator
) -> list[list[float]]:
    """Run both controllers on their robots until the master is done."""
    simulation = Simulation(bench.model, list(ROBOTS), seed=trial.seed, data=bench.data)
    modems = ModemConfig(error_rate=trial.byte_errors)
    links = virtual_links(ROBOTS, lambda: simulation.time, rng, modems)
    robots = [simulation.robots[name] for name in ROBOTS]
    for robot in robots:
        robot.activate()
    course: list[list[float]] = []
    for _ in range(round(LIMIT / PERIOD)):
        for robot, link, side in zip(robots, links.values(), (master, slave), strict=True):
            command, message = side.step(robot.observe(), link.poll().messages)
            if message is not None:
                link.send_latest(message)
                link.poll()
            robot.command(command)
        simulation.tick()
        course.append(_row(bench, master, simulation.time))
        if master.stage is Stage.OVER:
            break
    simulation.close()
    return course


def _row(bench: TrussBench, master: Master, time: float) -> list[float]:
    """Return a line of the course."""
    bench.look()
    grippers: list[float] = []
    for name in ROBOTS:
        place = bench.data.site(f"{name}/gripper").xpos
        grippers += [place[1], place[2], bench.place(f"{name}/wrist")[2]]
    bases = [bench.place(f"{name}/chassis") for name in ROBOTS]
    return [
        time,
        list(Stage).index(master.stage),
        master.target[1],
        *bench.contact(),
        *grippers,
        *bench.grips().ravel(),
        *bench.joints()[:, 1:].ravel(),
        *np.ravel(bases),
        *bench.efforts()[:, 1:].ravel(),
        *bench.base_wrenches().ravel(),
    ]
