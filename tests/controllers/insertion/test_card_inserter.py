"""The slave inserts the card by guidance and force, and stops without either."""

import copy
import dataclasses
import functools

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.card_arm import inverse, pitch_of, to_plane
from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.guidance import Guidance
from controllers.insertion.seating import SeatingConfig
from controllers.mapping.localization import tilt_to_level
from controllers.motion.base_tilt import BaseTilt, drawn_springs
from models import datasheets
from tests.controllers.insertion.kinematic import SLOT, STEER, Slave
from twin.describe import describe_rover
from twin.robot import MISSING, ArmMode, Channel, Validity, WheelMode

SEATING = SeatingConfig(0.04, 3.0, 0.0084)
LEVER = datasheets.ROVER.arm_mount[1]  # Of the arm's base ahead of where the robot turns [m].
NOTHING_SEEN = Guidance(0.0, False, False, None, np.zeros((6, 6)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slip", "error"),
    [
        (1.0, None),
        (0.9, [3e-3, -3e-3, 4e-3, 2e-3, 1e-3, -2e-3]),
    ],
)
def test_card_is_brought_before_the_slot_and_in(slip, error):
    """Also where wheels slip by a tenth and the map is off: looks make up for both."""
    slave = Slave((0.01, -0.72, 0.04), slip)
    inserter = slave.inserter(error)
    reached = {}

    def note():
        reached.setdefault(inserter.stage, slave.error())
        return inserter.over

    slave.run(inserter, 40.0, until=note)
    assert inserter.stage is InsertionStage.DONE, inserter.reason
    assert list(reached) == [
        InsertionStage.WAIT,
        InsertionStage.APPROACH,
        InsertionStage.ALIGN,
        InsertionStage.INSERT,
        InsertionStage.DONE,
    ]
    across, ahead, turn, beside, yaw = reached[InsertionStage.INSERT]
    assert abs(across) < 1.2e-3 and abs(turn) < np.radians(0.7)
    assert ahead == pytest.approx(-inserter.config.stand_off, abs=2e-3)
    assert slave.error()[1] == pytest.approx(inserter.config.guide.depth, abs=2e-3)
    # The slot's walls are as wide as this.
    assert abs(beside) < 0.01 and abs(yaw) < 0.06


@pytest.mark.slow
def test_base_tilt_under_the_arm_is_fed_forward():
    """Springs four times softer than the rover's: the card's path tilts the base by 1 mm."""
    soft = (
        dataclasses.replace(axis, stiffness=axis.stiffness / 4.0)
        for axis in drawn_springs(describe_rover())
    )
    base = BaseTilt(*soft, datasheets.ROVER.arm_mount)
    ended = {}
    for fed in (None, base):
        slave = Slave((0.01, -0.72, 0.04), springs=base)
        inserter = slave.inserter(base=fed)
        slave.run(
            inserter, 40.0, until=lambda inserter=inserter: inserter.stage is InsertionStage.INSERT
        )
        begun = slave.error()[0]
        slave.run(inserter, 40.0, until=lambda inserter=inserter: inserter.over)
        assert inserter.stage is InsertionStage.DONE, inserter.reason
        ended[fed is base] = slave.error()[0] - begun
    assert abs(ended[False]) > 1e-3
    assert abs(ended[True]) < 0.15 * abs(ended[False])


@pytest.mark.parametrize("seats", [True, False])
def test_a_card_that_comes_askew_before_guides_is_brought_anew(seats):
    """The robot stops so far beside the slot's line that its arm points 5 degrees across it."""
    slave = Slave((0.04, -0.53, 0.0))
    inserter = slave.inserter(seating=SEATING if seats else None)
    places = []

    def note():
        places.append(slave.place[1])
        return inserter.stage is InsertionStage.INSERT

    slave.run(inserter, 60.0, until=note)
    assert inserter.stage is InsertionStage.INSERT
    crooked = abs(slave.error()[4]) > inserter.config.crooked
    assert crooked != seats
    assert (min(places) < -0.7) == seats


@pytest.mark.parametrize(("roll", "goes"), [(8.7, True), (-8.7, True), (9.2, False), (-9.2, False)])
def test_a_card_that_rolls_beyond_the_guides_mouths_is_not_pushed_past_them(roll, goes):
    """Its edges, 54 mm from its middle, come 8.2 and 8.6 mm off; the mouths open by 8.4."""
    slave = Slave((0.01, -0.64, 0.0))
    place = RigidTransform.from_translation((inverse(slave.robot()) @ SLOT)[:3, 3])
    rolled = place * RigidTransform.from_exp_coords([0.0, np.radians(roll), 0, 0, 0, 0])
    error = (rolled * place.inv()).as_exp_coords()
    inserter = slave.inserter(error, watched=False, seating=SEATING)
    slave.run(
        inserter, 40.0, until=lambda: inserter.stage is InsertionStage.INSERT or inserter.over
    )
    assert (inserter.stage is InsertionStage.INSERT) == goes
    assert inserter.reason == ("" if goes else "rolled")


@pytest.mark.parametrize("forced", [True, False])
def test_a_card_goes_into_guides_by_force_or_straight_ahead(forced):
    slave = Slave((0.01, -0.64, 0.0))
    inserter = slave.inserter(seating=SEATING, forced=forced)
    slave.run(inserter, 40.0, until=lambda: inserter.stage is InsertionStage.INSERT)
    slave.push[0] = 1.0  # across
    before = slave.error()
    slave.run(inserter, 1.0, looks=False)
    moved = slave.error() - before
    assert moved[1] > 3e-3
    assert (moved[0] > 5e-4) == forced


@pytest.mark.parametrize("looks", [True, False])
def test_a_slave_that_takes_no_views_goes_by_its_map_alone_and_is_off_by_what_that_is(looks):
    slave, aside = Slave((0.01, -0.64, 0.0)), 4e-3
    inserter = slave.inserter([0.0, 0.0, 0.0, aside, 0.0, 0.0], watched=False)
    slave.run(inserter, 20.0, until=lambda: inserter.stage is InsertionStage.INSERT, looks=looks)
    assert inserter.stage is InsertionStage.INSERT
    across, ahead, _, beside, _ = slave.error()
    assert beside == pytest.approx(aside, abs=1e-3) and abs(across) < 1e-3
    assert ahead == pytest.approx(-inserter.config.stand_off, abs=1e-3)


@functools.cache
def before_the_slot():
    """Return a slave that begins to insert, and its controller."""
    slave = Slave((0.01, -0.64, 0.03))
    inserter = slave.inserter()
    slave.run(inserter, 40.0, until=lambda: inserter.stage is InsertionStage.INSERT)
    slave.run(inserter, 0.3, looks=False)
    assert inserter.stage is InsertionStage.INSERT
    return slave, inserter


def inserting():
    return copy.deepcopy(before_the_slot())


@functools.cache
def under_way():
    """Return a slave in the approach, and its controller."""
    slave = Slave()
    inserter = slave.inserter()
    slave.run(inserter, 2.5)
    assert inserter.stage is InsertionStage.APPROACH
    return slave, inserter


def approaching(**changes):
    slave, inserter = copy.deepcopy(under_way())
    inserter.config = dataclasses.replace(inserter.config, **changes)
    return slave, inserter


def test_speeds_stay_within_their_limits():
    slave, inserter = inserting()
    motions = np.array([inserter._steer.motion(c.wheels) for c in slave.commands])
    assert np.abs(motions[:, 0]).max() <= inserter.config.speed + 1e-9
    assert np.abs(motions[:, 1]).max() <= inserter.config.turn + 1e-9
    arms = np.array([c.arm for c in slave.commands])
    cards = np.array([slave.arm.transform_card_to_robot(a).translation for a in arms[::5]])
    speed = np.linalg.norm(np.diff(cards, axis=0), axis=1) / 0.05
    assert speed.max() <= inserter.config.card_speed * 1.02


def test_slave_moves_slowly_until_card_and_slot_were_seen_together():
    """The master's camera has to follow a card that it sees alone."""
    slave, speeds = Slave((0.0, -1.1, 0.2)), {}
    inserter = slave.inserter()
    for slot_seen in (False, True):
        begun = len(slave.commands)
        for tick in range(300):
            view = dataclasses.replace(slave.look(), slot_seen=slot_seen)
            slave.drive(inserter.step(slave.observe(), [] if tick % 25 else [view]))
        motions = np.abs([inserter._steer.motion(c.wheels) for c in slave.commands[begun:]])
        speeds[slot_seen] = motions.max(axis=0)
    share = inserter.config.following
    limits = np.array([inserter.config.speed, inserter.config.turn])
    assert np.all(speeds[False] <= share * limits + 1e-9)
    assert speeds[True][0] > speeds[False][0] / share * 0.9


def approach(start, **changes):
    """Return where a slave is in each tick of its approach (N, 3), the commands, the controller."""
    slave = Slave(start)
    inserter = slave.inserter(**changes)
    places = []

    def note():
        if inserter.stage is InsertionStage.APPROACH:
            places.append((slave.place.copy(), slave.commands[-1]))
        return inserter.stage is InsertionStage.ALIGN

    slave.run(inserter, 30.0, until=note)
    assert inserter.stage is InsertionStage.ALIGN
    return np.array([place for place, _ in places]), [c for _, c in places], slave, inserter


def base_of(place):
    """Return (..., 2) where the base of the arm is of a robot at (..., 3) x, y and yaw."""
    ahead = np.stack([-np.sin(place[..., 2]), np.cos(place[..., 2])], axis=-1)
    return place[..., :2] + LEVER * ahead


@pytest.mark.parametrize("start", [(0.05, -1.1, 0.0), (-0.03, -1.0, 0.15), (0.0, -1.0, -0.2)])
def test_the_robot_points_the_base_of_its_arm_at_its_place_and_slows_before_it(start):
    places, commands, _, inserter = approach(start)
    config = inserter.config
    goal = np.array([0.0, LEVER - config.reach - config.stand_off])
    to_goal = goal - places[:, :2]
    bearing = np.arctan2(-to_goal[:, 0], to_goal[:, 1]) - places[:, 2]
    # Its rate by the distance driven is -bearing / lever, and bearing / what is left to drive.
    gone = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1))]
    )
    left = np.linalg.norm(to_goal[0])
    expected = bearing[0] * np.exp(-gone / LEVER) * left / (left - gone)
    np.testing.assert_allclose(bearing, expected, atol=0.015)
    assert np.ptp(bearing) > 0.05
    np.testing.assert_allclose(base_of(places[-1]), goal, atol=6.5e-3)
    assert abs(base_of(places[-1])[0]) < 2e-3
    forward = np.array([inserter._steer.motion(command.wheels)[0] for command in commands])
    gaps = np.linalg.norm(goal - base_of(places), axis=1)
    wanted = np.clip(config.slowing * gaps, -config.speed, config.speed)
    np.testing.assert_allclose(forward[1:-1], wanted[1:-1], atol=3e-3)
    assert forward.max() == pytest.approx(config.speed) and forward[-2] < 0.2 * config.speed


def test_a_robot_far_beside_the_slots_line_turns_no_farther_than_to_its_place_nor_on_the_spot():
    places, commands, _, inserter = approach((0.09, -1.1, 0.0))
    config = inserter.config
    assert abs(base_of(places[-1])[0]) < 2e-3
    assert 0.8 < np.abs(places[:, 2]).max() / np.arctan2(0.09, 1.1 - config.reach) < 1.2
    motions = np.array([inserter._steer.motion(command.wheels) for command in commands])
    curves = np.abs(motions[:, 1]) - config.turn / config.speed * np.abs(motions[:, 0])
    assert curves.max() < 1e-9


@pytest.mark.parametrize(("gap", "turns"), [(0.03, False), (0.3, True)])
def test_a_robot_on_a_slope_turns_uphill_only_where_it_slides_by_less_than_that_brings(gap, turns):
    """Near its place it would slide past it, and turn ever farther."""
    slave, inserter = approaching()
    inserter._steer = inserter._odometry._steer = dataclasses.replace(STEER, slide=0.7)
    seen = slave.observe()
    right_side_down = seen.inclinometer._replace(value=np.array([0.0, 0.15]))
    for _ in range(300):
        inserter._odometry.update(seen._replace(inclinometer=right_side_down), 0.01)
    turn = {side: STEER.motion(inserter._wheels_to(side * 0.01, gap))[1] for side in (-1, 1)}
    assert turn[1] < 0.0
    assert turn[-1] > 0.0 if turns else turn[-1] == 0.0
    # Downhill a smaller turn does.
    assert abs(turn[1]) < 0.01 / (LEVER * (gap + LEVER)) * min(0.06, 0.8 * gap)


def test_the_card_stays_where_the_arm_is_at_ease_until_the_robot_is_there():
    _, commands, slave, inserter = approach((0.0, -1.0, 0.0))
    ahead = [
        slave.arm.transform_card_to_robot(c.arm).translation[1]
        for c in commands
        if np.any(c.wheels)
    ]
    settled = np.array(ahead)[-200:]
    np.testing.assert_allclose(settled, inserter.config.reach, atol=3e-3)


@pytest.mark.parametrize("looks", [[], [NOTHING_SEEN]])
def test_nothing_moves_before_the_first_guidance_message_and_without_one_insertion_fails(looks):
    slave = Slave()
    inserter = slave.inserter(first=2.0)
    for _ in range(400):
        slave.drive(inserter.step(slave.observe(), looks))
    assert inserter.stage is InsertionStage.FAILED and inserter.reason == "target not seen"
    assert slave.stands_still(400)
    np.testing.assert_array_equal(slave.commands[0].arm, Slave().angles)


def test_stale_guidance_is_extended_by_dead_reckoning_and_then_insertion_fails():
    slave, inserter = approaching(lost=2.5)
    place = slave.place.copy()
    slave.run(inserter, inserter.config.stale + 0.3, looks=False)
    assert slave.place[1] > place[1] + 0.02  # it still drives
    slave.run(inserter, inserter.config.lost, looks=False, until=lambda: inserter.over)
    assert inserter.stage is InsertionStage.FAILED and inserter.reason == "target not seen"
    slave.run(inserter, 0.5)
    assert slave.stands_still(50)


def test_slave_with_a_large_covariance_stops_until_the_next_guidance_message():
    slave, inserter = approaching(known=1e-4)
    slave.run(inserter, inserter.config.stale + 0.1, looks=False)
    place = slave.place.copy()
    slave.run(inserter, 2.0, looks=False)
    assert slave.stands_still(200) and not inserter.over
    slave.run(inserter, 1.0)
    assert slave.place[1] > place[1] + 0.01


def test_wrench_beyond_the_limit_stops_everything():
    slave, inserter = inserting()
    slave.push[:2] = [0.0, -10.0]
    slave.run(inserter, 1.0, looks=False)
    assert inserter.stage is InsertionStage.FAILED and inserter.reason == "force"
    assert slave.stands_still(95)


@pytest.mark.parametrize("stage", [InsertionStage.APPROACH, InsertionStage.ALIGN])
def test_slowly_growing_force_before_the_slot_stops_everything(stage):
    """Before the slot, where the wrench is tared, it must not be tared away."""
    slave, inserter = approaching(aligned=(0.0, 0.0))
    slave.run(inserter, 20.0, until=lambda: inserter.stage is stage)
    for _ in range(600):
        slave.push[1] -= 0.02 if stage is InsertionStage.ALIGN else 0.1
        slave.drive(inserter.step(slave.observe(), [slave.look()]))
        if inserter.over:
            break
    assert inserter.stage is InsertionStage.FAILED and inserter.reason == "force"
    assert -10.0 < slave.push[1] < -8.0


def test_push_on_the_card_is_felt_less_what_was_there_before():
    slave, inserter = inserting()
    slave.push[:] = [0.5, -0.4, 0.2, 0.01, 0.02, 0.03]
    inserter.step(slave.observe(), [])
    np.testing.assert_allclose(inserter.contact, slave.push, atol=1e-3)


def test_force_guides_by_what_pushes_across_and_along_the_slot_and_turns_in_its_plane():
    slave, inserter = inserting()
    felt = []
    step = inserter.guide.step
    inserter.guide.step = lambda wrench: (felt.append(np.array(wrench)), step(wrench))[1]
    slave.push = np.array([0.4, -0.7, 0.2, 0.01, 0.02, -0.03])
    slave.run(inserter, 0.02, looks=False)
    np.testing.assert_allclose(felt[-1], slave.push[[0, 1, 5]], atol=2e-3)


def test_slot_is_where_it_was_while_the_arm_has_not_moved_since_the_hand_over():
    slave = Slave((0.0, -0.6, 0.0))
    base = BaseTilt(*drawn_springs(describe_rover()), datasheets.ROVER.arm_mount)
    inserter = slave.inserter(base=base)
    inserter.step(slave.observe(), [])
    slot = inserter.belief.slot_in_start
    inserter._hand_over(slot)
    np.testing.assert_allclose(inserter._slot_now(), slot, atol=1e-12)


def test_weight_at_the_hand_over_is_that_of_the_tilted_arm():
    slave, inserter = approaching()
    tilt = np.array([0.12, -0.08])
    seen = slave.observe()
    seen = seen._replace(inclinometer=seen.inclinometer._replace(value=tilt))
    command = inserter.step(seen, [])
    inserter._hand_over(inserter.belief.slot_in_start)
    up = tilt_to_level(tilt).inv().apply([0.0, 0.0, 1.0])
    expected = slave.arm.weight(command.arm, up)
    np.testing.assert_allclose(inserter._weight, expected, atol=1e-9)
    assert np.abs(expected - slave.arm.weight(command.arm, [0.0, 0.0, 1.0])).max() > 0.5


def test_robot_that_begins_too_near_backs_straight():
    _, commands, slave, inserter = approach((0.01, -0.35, 0.15))
    motions = np.array([inserter._steer.motion(command.wheels) for command in commands[1:-1]])
    assert motions[:, 0].min() == pytest.approx(-inserter.config.speed)
    assert np.abs(motions[:, 1]).max() < 1e-9
    assert abs(slave.error()[1] + inserter.config.stand_off) < 0.03


@pytest.mark.parametrize("known", [4e-3, 0.1])
def test_a_card_that_the_master_does_not_see_is_inserted_only_by_an_estimate_good_enough(known):
    """All the time it sees the slot, which alone tells nothing of the card."""
    slave, inserter = approaching(known=known, patience=3.0)
    for _ in range(2500):
        slot_alone = Guidance(slave.time, False, True)
        slave.drive(inserter.step(slave.observe(), [slot_alone]))
        if inserter.over or inserter.stage is InsertionStage.INSERT:
            break
    if known > 0.01:
        assert inserter.stage is InsertionStage.INSERT
    else:
        assert inserter.stage is InsertionStage.FAILED and inserter.reason == "target not seen"


def test_arm_stays_where_it_is_measured_after_a_failure():
    slave, inserter = approaching(timeout=0.0)
    seen = slave.observe()
    measured = slave.angles + [0.01, -0.02, 0.03, 0.01]
    seen = seen._replace(arm_angles=seen.arm_angles._replace(value=measured))
    for _ in range(2):
        np.testing.assert_array_equal(inserter.step(seen, []).arm, measured)
    assert inserter.reason == "out of time"


def test_contact_without_a_wrench_is_six_zeros_before_the_slot_and_unknown_while_inserting():
    for (slave, inserter), contact in ((approaching(), 0.0), (inserting(), np.nan)):
        inserter.step(slave.observe()._replace(arm_base_wrench=MISSING), [])
        np.testing.assert_array_equal(inserter.contact, np.full(6, contact))


def test_lost_wrench_in_contact_does_not_go_on():
    slave, inserter = inserting()
    ahead = slave.error()[1]
    for _ in range(100):
        slave.drive(inserter.step(slave.observe()._replace(arm_base_wrench=MISSING), []))
    assert slave.error()[1] < ahead + 2e-3
    assert inserter.stage is not InsertionStage.DONE


@pytest.mark.parametrize("bad", [MISSING, Channel(np.full(4, np.nan), 0.0, Validity.MEASURED)])
@pytest.mark.parametrize("channel", ["arm_angles", "arm_rates"])
def test_missing_joints_take_the_duty_off_for_good(channel, bad):
    slave, inserter = approaching()
    command = inserter.step(slave.observe()._replace(**{channel: bad}), [])
    assert command.wheel_mode is WheelMode.DUTY and command.arm_mode is ArmMode.DUTY
    np.testing.assert_array_equal([*command.wheels, *command.arm], 0.0)
    assert inserter.stage is InsertionStage.FAILED and inserter.reason == "no arm angles"
    slave.run(inserter, 0.5)
    assert slave.stands_still(50)


def test_reason_from_outside_stops_for_good():
    slave, inserter = approaching()
    inserter.stop("wrench missing")
    slave.run(inserter, 0.5)
    assert inserter.reason == "wrench missing" and slave.stands_still(50)
    inserter.stop("another")
    assert inserter.reason == "wrench missing"
    inserter.step(slave.observe()._replace(arm_angles=MISSING), [])
    assert inserter.reason == "wrench missing"


def test_card_that_is_in_stays_in_when_joints_go_missing():
    slave, inserter = inserting()
    inserter.stage = InsertionStage.DONE
    command = inserter.step(slave.observe()._replace(arm_angles=MISSING), [])
    assert command.arm_mode is ArmMode.DUTY and not np.any(command.arm)
    assert inserter.stage is InsertionStage.DONE and inserter.reason == ""


def test_task_that_takes_too_long_is_given_up():
    slave, inserter = approaching(timeout=2.8)
    slave.run(inserter, 0.8)
    assert inserter.reason == "out of time" and slave.stands_still(45)


@pytest.mark.parametrize("kind", ["missing", "stale", "not finite"])
@pytest.mark.parametrize("channel", ["wheel_speeds", "inclinometer", "arm_base_wrench"])
def test_spoilt_channel_never_makes_a_command_that_is_not_finite(channel, kind):
    slave, inserter = approaching()

    def spoil(seen):
        good = getattr(seen, channel)
        spoilt = {
            "missing": MISSING,
            "stale": good._replace(validity=Validity.STALE),
            "not finite": Channel(np.full_like(good.value, np.nan), good.stamp, Validity.MEASURED),
        }
        return seen._replace(**{channel: spoilt[kind]})

    for tick in range(80):
        looks = [slave.look()] if tick % 25 == 0 else []
        seen = slave.observe()
        command = inserter.step(spoil(seen) if tick % 40 < 20 else seen, looks)
        slave.drive(command)
    numbers = [[*c.wheels, *c.arm, *c.arm_rates] for c in slave.commands]
    assert np.isfinite(numbers).all()
    assert np.isfinite(inserter.belief.slot_in_start).all()


def test_outlying_guidance_message_moves_nothing_far():
    slave, inserter = approaching()
    before = inserter.belief.slot_in_start.copy()
    true = slave.look()
    wild = Slave((0.3, -0.5, 0.3)).look()
    for look in (dataclasses.replace(wild, time=true.time), dataclasses.replace(true, time=-5.0)):
        slave.drive(inserter.step(slave.observe(), [look]))
    after = inserter.belief.slot_in_start
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_card_is_brought_without_turn_in_the_slots_plane_by_a_robot_that_rolls() -> None:
    """By the pose that the joints give; the slot's own pitch would leave roll times yaw."""
    slave, roll, yaw = Slave((0.0, -0.62, 0.0)), 0.25, 0.08
    inserter = slave.inserter()
    inserter.step(slave.observe(), [])
    tilted = np.eye(4)
    tilted[:3, :3] = Rotation.from_euler("yz", [roll, yaw]).as_matrix()
    level = inverse(slave.robot()) @ SLOT
    about = slave.arm.card_frame(slave.angles)
    slot = level.copy()
    slot[:3, :3] = tilted[:3, :3] @ level[:3, :3]
    slot[:3, 3] = about[:3, 3] + slot[:3, :3] @ [0.0, 0.015, 0.0]
    for _ in range(1000):
        inserter._bring(slot, np.array([0.0, -0.015, 0.0]))
    card = slave.arm.card_frame(inserter._wanted)
    across, ahead, turn, *_ = to_plane(inverse(slot) @ card)
    np.testing.assert_allclose([across, ahead, turn], [0.0, -0.015, 0.0], atol=1e-4)
    # What the slot's pitch would have left.
    assert abs(pitch_of(card) - pitch_of(slot)) > 0.5 * roll * yaw


def test_arm_that_does_not_reach_where_force_guides_it_fails_and_is_not_done(monkeypatch) -> None:
    """The guide goes by its own commands: a card that stays where it is would count as seated."""
    slave = Slave((0.01, -0.72, 0.04))
    inserter = slave.inserter()
    slave.run(inserter, 40.0, until=lambda: inserter.stage is InsertionStage.INSERT)
    assert inserter.stage is InsertionStage.INSERT
    monkeypatch.setattr(slave.arm, "angles_at", lambda *_: np.full(4, np.nan))
    slave.run(inserter, 40.0, until=lambda: inserter.over)
    assert inserter.stage is InsertionStage.FAILED and inserter.reason == "out of reach"
