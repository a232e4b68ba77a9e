"""Stages ``place``, ``insert``, ``rest`` and ``identify``: what starts, ends and repeats them."""

import math
import types
import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.identification.pitch import PitchPrior
from controllers.identification.rover_identifier import RoverIdentifierConfig
from controllers.insertion.camera_station import CameraStation, camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.guidance import Guidance
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import ARM_REACH
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mapping.shared_map import SharedMap
from controllers.mission.belief import MissionBelief
from controllers.mission.exchange import ArmReady, TurnShare
from controllers.mission.stages import identify
from controllers.mission.stages.identify import SwingArm
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from controllers.mission.stages.meet import GuidedSlave
from controllers.mission.stages.place import PlaceCamera
from controllers.mission.stages.rest import Rest
from controllers.motion.base_tilt import drawn_springs
from perception.geometry.se3 import transport_covariance
from perception.voxels.map import Surface
from tests.controllers.mission.hand_made import (
    HOME,
    MASTER,
    POSES,
    ROVERS,
    SITE,
    SLAVE,
    TILT,
    KinematicRover,
    belief_of,
    exchange_with,
    planar_pose,
    transform_robot_to_ground,
)
from twin.robot import Command, Observation

CAMERA_ARM = camera_arm(ROVERS[MASTER])[0]
HEIGHT = ROVERS[MASTER].centre_height


def station_ahead(side: float, ahead: float, turn: float) -> CameraStation:
    """Return a station by its pose in the frame of the master where it begins."""
    x, y, yaw = POSES[MASTER]  # Its yaw is a quarter turn: ahead is -x, and right is y.
    return CameraStation((x - ahead, y + side, yaw + turn), np.zeros(4), 0.5, 0.0)


def off_axis(angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the angles between the optical axis of the left camera and a point."""
    x, y, z = CAMERA_ARM.tool_in_robot(angles).apply(point, inverse=True)
    return np.array([math.atan2(x, z), math.atan2(y, z)])


def test_master_folds_its_arm_and_drives_to_the_station_by_its_own_turn_share() -> None:
    belief, station = belief_of(MASTER), station_ahead(-0.2, 0.4, 0.5)
    slot, prior = belief.transform_slot_to_level, np.diag(np.square([1, 2, 3, 4, 5, 6])) * 1e-4
    belief.slot_covariance, belief.turn_share = prior, TurnShare(0.7, 0.05)
    stage = PlaceCamera(belief, station)
    rover = KinematicRover(MASTER, HOME + [0.5, 0.2, 0.0, -0.1], left=0.7, right=0.7)
    while np.abs(rover.command.arm - HOME).max() > 0.05:
        rover.step(stage)
        assert not rover.drives
    while not stage.done and rover.ticks < 4000:
        rover.step(stage)
    assert stage.done and stage.stops == 1
    x, y, _ = rover.pose.translation
    # As near as the drive's own tolerances.
    np.testing.assert_allclose([x, y, rover.yaw], [-0.2, 0.4, 0.5], atol=0.02)
    # It climbs, by its pitch.
    assert rover.pose.translation[2] > 0.01
    expected = rover.pose.inv() * slot
    np.testing.assert_allclose(
        belief.transform_slot_to_level.as_matrix(), expected.as_matrix(), atol=2e-6
    )
    # 2 cm and 5 % of the distance; 0.03 rad and 5 % of the turns; 0.02 rad of tilt; 1 cm of height,
    # 5 % of the climb along its steepest tilt, and 0.01 rad of pitch against the ground.
    place, turn = 0.02 + 0.05 * rover.driven, 0.03 + 0.05 * rover.turned
    steepest = np.linalg.norm(tilt_to_level(TILT).rotation.as_matrix()[:2, 2])
    height = np.linalg.norm([0.01, 0.05 * steepest * rover.driven, 0.01 * rover.driven])
    added = np.diag(np.square([0.02, 0.02, turn, place, place, height]))
    # And what an error of the turn share makes of the drive.
    slip = stage._drive.odometry.slip()
    moved = prior + np.outer(slip, slip)
    covariance = transport_covariance(rover.pose.inv(), moved) + added
    np.testing.assert_allclose(belief.slot_covariance, covariance, atol=1e-7)
    np.testing.assert_allclose(rover.command.arm, HOME, atol=1e-9)
    assert not rover.drives


class Maps:
    """A map in which the master finds itself as a test decides.

    Attributes:
        found: Results of the localizations to come; the last one repeats.
        located: Arguments of each localization: arm, joint angles, tilt, pair and settings.
    """

    def __init__(self, *found: RobotLocalization | None) -> None:
        self.found = list(found)
        self.located: list[tuple[typing.Any, ...]] = []
        points = np.array([[9.0, 9.0, 0.0]])
        surface = Surface(points, 1e-8 * np.eye(3)[None], np.ones(1))
        self.voxels = types.SimpleNamespace(surface=lambda: surface)
        self.transform_target_to_world = RigidTransform.identity()

    def locate(self, *known: typing.Any) -> RobotLocalization | None:
        """Return the next result."""
        self.located.append(known)
        return self.found.pop(0) if len(self.found) > 1 else self.found[0]


def with_map(*found: RobotLocalization | None) -> tuple[MissionBelief, Maps]:
    belief, maps = belief_of(MASTER), Maps(*found)
    belief.map = typing.cast(SharedMap, maps)
    return belief, maps


def off_station(station: CameraStation, side: float, ahead: float, turn: float):
    """Return the localization by which the station is so far away in the robot frame."""
    x, y, yaw = station.place
    below = RigidTransform.from_translation([0.0, 0.0, -HEIGHT])
    to_level = below * planar_pose(side, ahead, turn) * planar_pose(x, y, yaw).inv()
    slot = to_level * SITE.insertion.transform_slot_to_ground
    to_world = SITE.transform_slot_to_panel * slot.inv()
    return RobotLocalization(CAMERA_ARM, to_world, 1e-8 * np.eye(6), np.zeros((6, 10)))


NEAR = station_ahead(0.0, 0.1, 0.2)  # The drive does not back off.


@pytest.mark.parametrize(
    ("error", "again"),
    [
        ((0.058, 0.0, 0.0), False),
        ((0.0, -0.058, 0.0), False),
        ((0.0, 0.02, -0.117), False),
        ((0.062, 0.0, 0.0), True),
        ((0.0, -0.062, 0.0), True),
        ((-0.045, 0.045, 0.0), True),
        ((0.0, 0.02, 0.123), True),
        ((0.0, 0.02, -0.123), True),
    ],
)
def test_master_drives_again_if_it_is_6_cm_or_012_rad_off_the_station(
    error: tuple[float, float, float], again: bool
) -> None:
    belief, maps = with_map(off_station(NEAR, *error))
    stage, rover = PlaceCamera(belief, NEAR), KinematicRover(MASTER)
    while not maps.located and rover.ticks < 2000:
        rover.step(stage)
    assert stage.done != again and stage.stops == 1
    if again:
        end = rover.ticks + 400
        while not rover.drives and rover.ticks < end:
            rover.step(stage)
        assert rover.drives and not stage.done


def test_master_goes_where_its_second_drive_is_to_end() -> None:
    belief, maps = with_map(off_station(NEAR, 0.15, 0.3, 0.2), off_station(NEAR, 0.0, 0.01, 0.0))
    stage, rover = PlaceCamera(belief, NEAR), KinematicRover(MASTER)
    while not stage.done and rover.ticks < 4000:
        rover.step(stage)
    assert stage.done and stage.stops == len(maps.located) == 2
    expected = planar_pose(0.0, 0.1, 0.2) * planar_pose(0.15, 0.3, 0.2)
    np.testing.assert_allclose(rover.pose.as_matrix(), expected.as_matrix(), atol=0.03)


def test_master_that_never_arrives_ends_after_four_drives() -> None:
    belief, maps = with_map(off_station(NEAR, 0.0, 0.2, 0.2))
    stage, rover = PlaceCamera(belief, NEAR), KinematicRover(MASTER)
    while not stage.done and rover.ticks < 9000:
        rover.step(stage)
    assert stage.done and stage.stops == len(maps.located) == 4
    # 0.1 m to the station as drawn, then three times 0.2 m.
    assert rover.driven == pytest.approx(0.7, abs=0.03)


def test_master_points_at_the_panel_and_looks_around_until_no_view_is_left() -> None:
    belief, maps = with_map(None)
    stage, rover = PlaceCamera(belief, NEAR), KinematicRover(MASTER)
    while not stage.done and rover.ticks < 12000:
        rover.step(stage)
    assert stage.done and stage.stops == 1 and rover.driven < 0.11
    views = np.array([angles for _, angles, *_ in maps.located])
    panel = transform_robot_to_ground(MASTER).inv() * SITE.insertion.transform_slot_to_ground
    panel = rover.pose.inv() * panel * SITE.transform_slot_to_panel.inv()
    np.testing.assert_allclose(off_axis(views[0], panel.translation), 0.0, atol=1e-4)
    # Nine yaws of both postures, less those that resemble another view.
    assert 10 <= len(views) <= 19
    apart = np.abs(views[:, None] - views).max(axis=2) + np.eye(len(views))
    assert apart.min() > 0.02
    for _, _, tilt, pair, *_ in maps.located:
        np.testing.assert_array_equal(tilt, TILT)
        np.testing.assert_array_equal(pair, rover.seen.stereo.value)


CARD = CardArm(ROVERS[SLAVE], SITE.insertion.tip).transform_card_to_robot(HOME)
VIEW = Guidance(1.0, True, True, RigidTransform.identity(), 1e-8 * np.eye(6))


@pytest.fixture
def guided(monkeypatch: pytest.MonkeyPatch) -> list[MarkerGuide]:
    """Return a list that gets each stepped guide; each step yields the same guidance."""
    guided: list[MarkerGuide] = []

    def step(self: MarkerGuide, seen: Observation) -> tuple[Command, Guidance]:
        guided.append(self)
        return Command(np.ones(4), HOME), VIEW

    monkeypatch.setattr(MarkerGuide, "step", step)
    return guided


def test_master_aims_between_card_and_slot_and_guides_once_both_arms_are_ready(
    guided: list[MarkerGuide],
) -> None:
    belief = belief_of(MASTER)
    exchange, links = exchange_with(MASTER)
    stage = GuideInsertion(GuidedSlave(belief, SLAVE, exchange, CARD), placed=False)
    rover, fastest = KinematicRover(MASTER), 0.0
    ready = []
    while rover.seen.time < 6.0:
        command = rover.step(stage)
        fastest = max(fastest, np.abs(command.arm_rates).max())
        message = exchange.read(MASTER, ArmReady)
        assert message is not None
        ready.append(message.ready)
        if rover.ticks == 300:
            exchange.post(SLAVE, ArmReady(False))
    ground, slave = transform_robot_to_ground(MASTER), transform_robot_to_ground(SLAVE)
    slot = ground.inv() * SITE.insertion.transform_slot_to_ground
    middle = 0.5 * (slot.translation + (ground.inv() * slave * CARD).translation)
    middle = tilt_to_level(TILT).inv().apply(middle)
    np.testing.assert_allclose(off_axis(rover.command.arm, middle), 0.0, atol=1e-4)
    assert fastest == pytest.approx(0.5)
    # It is ready once it is there, with 0.6 s of rest.
    there = np.abs(rover.command.arm - HOME).max() / 0.5 + 0.6
    assert ready.index(True) * 0.01 == pytest.approx(there, abs=0.03) and ready[-1]
    assert not guided and not links[MASTER].sent and stage.done
    exchange.post(SLAVE, ArmReady(True))
    np.testing.assert_array_equal(rover.step(stage).wheels, np.ones(4))
    assert links[MASTER].sent == [VIEW] and len(guided) == 1
    assert guided[0].config.plan is None


def test_slave_inserts_once_its_arm_is_home_and_the_master_is_ready() -> None:
    belief = belief_of(SLAVE)
    exchange, links = exchange_with(SLAVE)
    stage = InsertCard(belief, MASTER, exchange)
    real, taken = stage.slave.inserter, []
    # The card's support is the pitching base, by the springs of its wheels.
    wheels = np.array([(wheel.spring, wheel.centre[1]) for wheel in ROVERS[SLAVE].wheels])
    stiffness = wheels[:, 0] @ wheels[:, 1] ** 2 / ARM_REACH**2
    assert real.config.guide.stiffness == pytest.approx(stiffness)
    assert not stage.done
    inserter = types.SimpleNamespace(over=False)

    def step(seen: Observation) -> Command:
        taken.append(links[SLAVE].receive(seen.time))
        return Command(np.ones(4), HOME)

    stage.slave = typing.cast(typing.Any, types.SimpleNamespace(step=step, inserter=inserter))
    rover = KinematicRover(SLAVE, HOME + [0.4, 0.0, 0.0, 0.0])
    exchange.post(MASTER, ArmReady(True))
    for _ in range(20):
        links[SLAVE].incoming.append(VIEW)
        rover.step(stage)
    assert exchange.read(SLAVE, ArmReady) is None  # Half a second to home.
    exchange.post(MASTER, ArmReady(False))
    for _ in range(200):
        links[SLAVE].incoming.append(VIEW)
        rover.step(stage)
    np.testing.assert_allclose(rover.command.arm, HOME, atol=1e-12)
    assert exchange.read(SLAVE, ArmReady) is None and not taken
    exchange.post(MASTER, ArmReady(True))
    for _ in range(65):  # 0.6 s of rest
        if exchange.read(SLAVE, ArmReady) is None:
            assert not rover.step(stage).wheels.any() and not taken
    assert exchange.read(SLAVE, ArmReady) == ArmReady(True)
    links[SLAVE].incoming.append(VIEW)
    np.testing.assert_array_equal(rover.step(stage).wheels, np.ones(4))
    # Guidance from before the stage is discarded; that of this tick is not.
    assert taken == [[VIEW]]
    assert not stage.done
    inserter.over = True
    assert stage.done and not real.over


def test_resting_robot_moves_its_arm_home_and_stays() -> None:
    stage = Rest(belief_of(SLAVE), "place")
    rover = KinematicRover(SLAVE, HOME + [0.3, -0.1, 0.2, 0.1])
    assert stage.name == "place" and stage.done
    for _ in range(60):
        rover.step(stage)
        assert not rover.drives
    np.testing.assert_allclose(rover.command.arm, HOME, atol=1e-12)


class FakeIdentifier:
    """Swings for three ticks, then fits for four; ends each fit with the next doubts."""

    def __init__(self, config: RoverIdentifierConfig, doubts: list[tuple[str, ...]]) -> None:
        self.config, self.swings, self.fits, self.repeated = config, 0, 0, 0
        self.fit = types.SimpleNamespace(estimate=types.SimpleNamespace(doubts=self._doubt))
        self._doubts = doubts

    def _doubt(self, prior: PitchPrior) -> tuple[str, ...]:
        return self._doubts.pop(0)

    @property
    def done(self) -> bool:
        return self.swings == 3

    def step(self, seen: dict[str, Observation]) -> dict[str, Command]:
        self.swings += 1
        return {SLAVE: Command(np.full(4, float(self.swings)))}

    def conclude(self) -> bool:
        self.fits += 1
        return self.fits % 4 == 0

    def hold(self) -> dict[str, Command]:
        return {SLAVE: Command(arm=np.full(4, 0.5))}

    def repeat(self) -> bool:
        self.repeated += 1
        if self.repeated > 1:
            return False
        self.swings = 0
        return True


def identify_with(
    doubts: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
) -> tuple[MissionBelief, FakeIdentifier, int]:
    """Return belief, identifier and ticks of a stage whose fits end with these doubts."""
    made: list[FakeIdentifier] = []

    def make(config: RoverIdentifierConfig, rng: np.random.Generator) -> FakeIdentifier:
        made.append(FakeIdentifier(config, doubts))
        return made[-1]

    monkeypatch.setattr(identify, "RoverIdentifier", make)
    belief = belief_of(SLAVE)
    stage, ticks = SwingArm(belief, np.random.default_rng(0)), 0
    while not stage.done:
        command = stage.step(Observation(0.01 * ticks))
        # A robot without a command would stop: the arm is held while the fit goes on.
        assert (command.wheels.size == 0) == np.array_equal(command.arm, np.full(4, 0.5))
        ticks += 1
    np.testing.assert_array_equal(stage.step(Observation(0.01 * ticks)).arm, np.full(4, 0.5))
    (identifier,) = made
    assert identifier.config.robot == SLAVE
    return belief, identifier, ticks


def test_identification_swings_then_holds_the_arm_while_it_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief, identifier, ticks = identify_with([()], monkeypatch)
    assert ticks == 3 + 4 and identifier.fits == 4
    assert belief.pitch is belief.identification is identifier.fit.estimate
    assert belief.doubts == ()


def test_identification_that_is_doubted_is_repeated_gently(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief, identifier, ticks = identify_with([("chi squared is 2.0",), ()], monkeypatch)
    assert ticks == 2 * (3 + 4) and belief.pitch is identifier.fit.estimate
    assert belief.doubts == ()
    assert identifier.repeated == 1


def test_robot_that_cannot_identify_itself_keeps_to_the_drawing_and_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    doubts = [("chi squared is 2.0",), ("chi squared is 1.5",)]
    belief, identifier, _ = identify_with(doubts, monkeypatch)
    assert belief.pitch is None and belief.identification is identifier.fit.estimate
    assert belief.doubts == ("chi squared is 1.5",)
    assert belief.springs() == drawn_springs(belief.robot)
