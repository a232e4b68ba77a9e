"""What the guide does with wrenches: gives way, ignores noise, draws back, stops."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.insertion.guide import GuideConfig, InsertionGuide, Phase, StraightInsertion

CONFIG = GuideConfig(0.10795, 0.3, 1981.25)
START = np.array([0.0, -0.01, 0.0])
INSIDE = np.array([0.0, 0.02, 0.0])


def wrench_at(point: tuple[float, float], force: tuple[float, float]) -> np.ndarray:
    return np.array([*force, point[0] * force[1] - point[1] * force[0]])


def held(guide: InsertionGuide, wrench, steps: int) -> np.ndarray:
    before = guide.command.copy()
    for _ in range(steps):
        guide.step(wrench)
    return guide.command - before


def test_without_force_the_card_is_inserted_straight():
    guide = InsertionGuide(CONFIG, START)
    for _ in range(600):
        guide.step(np.zeros(3))
    assert guide.phase is Phase.DONE
    np.testing.assert_allclose(guide.command[[0, 2]], 0.0)
    assert guide.command[1] == pytest.approx(CONFIG.depth, abs=2e-4)


def test_noise_within_the_deadband_moves_nothing_aside():
    guide = InsertionGuide(CONFIG, START)
    rng = np.random.default_rng(0)
    while not guide.over:
        guide.step(rng.normal(size=3) * [0.1, 0.1, 0.01])
    assert guide.phase is Phase.DONE
    assert abs(guide.command[0]) < 1e-4
    assert abs(guide.command[2]) < math.radians(0.1)


@pytest.mark.parametrize("side", [-1, 1])
def test_card_on_the_face_slides_away_from_the_side_that_touches(side):
    guide = InsertionGuide(CONFIG, START)
    moved = held(guide, wrench_at((side * 0.05, 0.0), (-0.2 * side, -1.0)), 60)
    assert guide.phase is Phase.SLIDE
    assert moved[0] * side < -1e-3
    assert moved[2] == 0.0


@pytest.mark.parametrize("side", [-1, 1])
def test_card_gives_way_to_a_corner_on_the_wall_and_turns_off_it(side):
    """The corner leads where the card is turned away: turning back is side * positive."""
    guide = InsertionGuide(CONFIG, INSIDE)
    half = side * CONFIG.card_width / 2.0
    moved = held(guide, wrench_at((half, 0.0), (-side * 2.8, -0.84)), 60)
    assert moved[0] * side < -1e-3
    assert moved[2] * side > 1e-4


@pytest.mark.parametrize("side", [-1, 1])
def test_card_turns_off_a_mouth_corner_the_other_way(side):
    guide = InsertionGuide(CONFIG, INSIDE)
    half = side * CONFIG.card_width / 2.0
    moved = held(guide, wrench_at((half, -0.02), (-side * 2.8, -0.84)), 60)
    assert moved[0] * side < -1e-3
    assert moved[2] * side < -1e-4


def test_couple_of_two_contacts_turns_the_card_straight():
    """State 5 with equal normals: the forces cancel, the couple is left."""
    guide = InsertionGuide(CONFIG, INSIDE)
    half = CONFIG.card_width / 2.0
    jam = wrench_at((-half, 0.0), (2.0, -0.6)) + wrench_at((half, -0.02), (-2.0, -0.6))
    moved = held(guide, jam, 30)
    assert moved[2] < -1e-3
    assert abs(moved[0]) < 5e-4


def test_filtered_force_reaches_two_thirds_of_a_steady_force_after_the_time_constant():
    guide = InsertionGuide(CONFIG, START)
    held(guide, np.zeros(3), 5)
    bent = []
    for _ in range(60):
        guide.step(np.array([0.2, 0.0, 0.0]))
        bent.append((guide.believed() - guide.command)[0] * CONFIG.stiffness)
    times = CONFIG.period * np.arange(1, len(bent) + 1)
    reached = times[np.argmax(np.array(bent) > 0.632 * 0.2)]
    # A median of three samples before it takes two more.
    assert reached == pytest.approx(0.03, abs=0.0251)
    assert bent[-1] == pytest.approx(0.2, rel=1e-3)


def test_one_spike_of_the_wrench_is_no_contact():
    guide = InsertionGuide(CONFIG, START)
    held(guide, np.zeros(3), 5)
    guide.step(np.array([80.0, -80.0, 5.0]))
    held(guide, np.zeros(3), 5)
    assert guide.phase is Phase.APPROACH
    assert guide.tries == 0
    np.testing.assert_allclose(guide.command[[0, 2]], 0.0)


def test_force_beyond_the_limit_draws_back_and_at_last_gives_up():
    guide = InsertionGuide(dataclasses.replace(CONFIG, retries=2), START)
    too_much = np.array([0.0, -6.0, 0.1])
    held(guide, too_much, 3)
    assert guide.phase is Phase.RETREAT
    before = guide.command[1]
    while guide.phase is Phase.RETREAT:
        guide.step(np.zeros(3))
    assert guide.command[1] < before - 0.9 * CONFIG.retreat
    for _ in range(2000):
        guide.step(too_much)
    assert (guide.phase, guide.reason) == (Phase.FAILED, "force")


def test_card_is_drawn_back_8_mm_from_where_it_jammed_in_the_slot():
    guide = InsertionGuide(CONFIG, INSIDE)
    held(guide, np.zeros(3), 50)
    held(guide, np.array([0.0, -6.0, 0.0]), 3)
    assert guide.phase is Phase.RETREAT
    before = guide.command[1]
    while guide.phase is Phase.RETREAT:
        guide.step(np.zeros(3))
    step = CONFIG.speed * CONFIG.period
    # The hand had bent by 3 mm.
    assert 0.008 <= before - guide.command[1] <= 0.008 + 6.0 / CONFIG.stiffness + 2 * step


def test_card_that_is_drawn_back_gives_way_to_the_side_it_is_pushed_to():
    guide = InsertionGuide(CONFIG, INSIDE)
    held(guide, np.array([4.0, -6.0, 0.0]), 3)
    assert guide.phase is Phase.RETREAT
    before = guide.command.copy()
    held(guide, np.array([2.0, 0.0, 0.0]), 20)
    assert guide.phase is Phase.RETREAT
    assert guide.command[0] > before[0] + 1e-4
    assert guide.command[2] == before[2]


def test_card_that_does_not_advance_is_a_jam():
    guide = InsertionGuide(CONFIG, INSIDE)
    held(guide, np.array([0.0, -3.2, 0.0]), 260)
    assert (guide.phase, guide.reason) == (Phase.RETREAT, "jam")


def test_time_runs_out():
    guide = InsertionGuide(dataclasses.replace(CONFIG, timeout=0.2), START)
    held(guide, np.zeros(3), 19)
    assert not guide.over
    held(guide, np.zeros(3), 2)
    assert (guide.phase, guide.reason) == (Phase.FAILED, "out of time")


def test_estimated_card_pose_includes_the_deflection_of_the_hand():
    guide = InsertionGuide(CONFIG, INSIDE)
    held(guide, np.array([0.2, -1.0, 0.0]), 60)
    bent = np.array([0.2, -1.0]) / CONFIG.stiffness
    np.testing.assert_allclose((guide.believed() - guide.command)[:2], bent, atol=1e-7)


@pytest.mark.parametrize("side", [-1, 1])
def test_next_try_begins_further_where_the_last_one_slid_to(side):
    guide = InsertionGuide(CONFIG, START)
    held(guide, wrench_at((side * 0.05, 0.0), (0.0, -1.0)), 60)
    while guide.phase is not Phase.RETREAT:
        before = guide.command[0]
        guide.step(wrench_at((side * 0.05, 0.0), (0.0, -6.0)))
    assert guide.command[0] - before == pytest.approx(-side * 1e-3)


@pytest.mark.parametrize("missing", [None, np.array([np.nan, 0.0, 0.0])])
def test_without_a_wrench_nothing_moves_and_after_half_a_second_it_is_over(missing):
    guide = InsertionGuide(CONFIG, START)
    held(guide, np.zeros(3), 10)
    np.testing.assert_array_equal(held(guide, missing, 40), 0.0)
    assert not guide.over
    assert held(guide, np.zeros(3), 1)[1] > 0.0
    np.testing.assert_array_equal(held(guide, missing, 60), 0.0)
    assert (guide.phase, guide.reason) == (Phase.FAILED, "no wrench")
    np.testing.assert_array_equal(held(guide, np.zeros(3), 5), 0.0)


@pytest.mark.parametrize("wrench", [[2.0, 0.0, 0.0], [2.0, -0.5, 0.3], [-2.0, 0.5, -0.3]])
def test_steady_force_never_runs_away(wrench):
    guide = InsertionGuide(CONFIG, INSIDE)
    moved = held(guide, np.array(wrench), 3000)
    assert guide.phase is Phase.FAILED
    assert abs(moved[0]) <= CONFIG.reach
    assert abs(moved[2]) <= CONFIG.turn_reach


def test_any_wrenches_leave_the_command_finite_and_bounded():
    rng = np.random.default_rng(0)
    for _ in range(20):
        guide = InsertionGuide(CONFIG, START)
        for _ in range(300):
            command = guide.step(rng.normal(size=3) * 10.0 ** rng.uniform(-3, 6))
            assert np.all(np.isfinite(command))
            assert abs(command[0]) <= CONFIG.reach + 5e-3
            assert abs(command[2]) <= CONFIG.turn_reach


@pytest.mark.parametrize("heading", [0.0, 0.05])
def test_straight_insertion_reaches_the_depth_of_guided_insertion_along_its_own_heading(heading):
    start = START + [0.0, 0.0, heading]
    guide = StraightInsertion(CONFIG, start)
    courses = [guide.step(np.zeros(3)) for _ in range(600)]
    assert guide.phase is Phase.DONE and not guide.reason
    way = courses[-1][:2] - start[:2]
    np.testing.assert_allclose(way / np.linalg.norm(way), [-np.sin(heading), np.cos(heading)])
    # It presses into the slot's end as hard as the guide does.
    pressed = CONFIG.depth + CONFIG.push / CONFIG.stiffness
    step = CONFIG.speed * CONFIG.period
    assert pressed <= courses[-1][1] < pressed + step
    assert np.linalg.norm(courses[0] - start) == pytest.approx(step)
    assert courses[-1][2] == heading


def test_straight_insertion_stops_at_the_limit_and_without_a_wrench():
    guide = StraightInsertion(CONFIG, START)
    guide.step(np.array([0.0, -4.5, 0.0]))
    assert (guide.phase, guide.reason) == (Phase.FAILED, "force")
    guide = StraightInsertion(CONFIG, START)
    guide.step(None)
    assert (guide.phase, guide.reason) == (Phase.FAILED, "no wrench")


@pytest.mark.parametrize("field, value", [("friction", -0.1), ("speed", 0.0), ("give", math.nan)])
def test_numbers_that_could_not_be_meant_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(CONFIG, **{field: value})


def test_a_start_that_is_no_pose_is_refused():
    with pytest.raises(ValueError, match="start"):
        InsertionGuide(CONFIG, np.array([0.0, np.nan, 0.0]))


def test_tare_holds_the_card_and_takes_off_a_zero_beyond_the_deadband():
    """With it the card goes as straight as an exact sensor lets it; without it it is led aside."""
    zero = np.array([0.5, -0.4, 0.03])
    tared = InsertionGuide(dataclasses.replace(CONFIG, tare=0.5), START)
    for _ in range(50):
        np.testing.assert_array_equal(tared.step(zero), START)
    plain = InsertionGuide(CONFIG, START)
    for _ in range(400):
        tared.step(zero)
        plain.step(zero)
    np.testing.assert_allclose(tared.command[[0, 2]], 0.0, atol=1e-12)
    assert tared.command[1] > START[1] + 0.03
    assert abs(plain.command[0]) > 1e-3


def test_tare_uses_the_wrenches_that_came():
    guide = InsertionGuide(dataclasses.replace(CONFIG, tare=0.1), START)
    for step in range(10):
        guide.step(None if step < 8 else np.array([1.0, 0.0, 0.0]))
    assert guide.phase is Phase.APPROACH
    moved = held(guide, np.array([1.0, 0.0, 0.0]), 20)
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-12)
