"""The bench presses the states that geometry constructs, and force guides the card in."""

import dataclasses
import functools
import json

import numpy as np
import pytest

from controllers.insertion.contact import STATES, contacts_of, pose_in_state, wrench_cone
from experiments.ch5.contact import contact as ch5_contact
from experiments.ch5.contact import seating
from experiments.ch5.contact.bench import Bench, HandAsMade, press, shape_of
from experiments.ch5.contact.trial import InsertionJob, StateJob, run_insertion, run_states
from experiments.harness.output import Output
from models.datasheets import CARD_AND_SLOT
from twin.sensors import ChannelSpec

MEDIUM, HARD = CARD_AND_SLOT.slot_widths[1:]
TILTS = {4: 0.38, 5: 0.22}


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("state", STATES)
def test_mujoco_contacts_agree_with_geometry_and_the_hand_senses_them(state, side):
    shape, bench = shape_of(MEDIUM), Bench(MEDIUM)
    pose = pose_in_state(shape, state, side, TILTS.get(state, 0.08), 0.008)
    contacts = contacts_of(shape, pose, state, side)
    wanted = wrench_cone(contacts, shape.friction) @ np.ones(2 * len(contacts))
    press(bench, pose, wanted)
    assert bench.true_state() == (state, side)
    np.testing.assert_allclose(bench.pose[:2], pose[:2], atol=1e-4)
    np.testing.assert_allclose(bench.sensed, bench.contact_wrench(), atol=1e-4)
    np.testing.assert_allclose(bench.sensed[:2], wanted[:2], atol=0.3)


def test_a_card_that_touches_nothing_is_in_no_state():
    bench = Bench(MEDIUM)
    bench.place(np.array([0.0, -0.02, 0.0]))
    bench.step(0.05)
    assert bench.true_state() == (0, 0)
    np.testing.assert_allclose(bench.sensed, 0.0, atol=1e-6)


@pytest.mark.parametrize("speed", [0.002, 0.02])
@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_a_card_that_slides_along_a_wall_feels_dry_friction_of_the_push(friction, speed):
    """A hand moves on steadily while it presses the card to the right."""
    bench = Bench(MEDIUM)
    bench.model.geom_friction[:, 0] = friction
    at_wall, push = np.array([0.5 * (MEDIUM - CARD_AND_SLOT.card_width), 0.01, 0.0]), 2.0
    pressed = at_wall + [push / bench.stiffness[0], 0.0, 0.0]
    bench.place(at_wall, pressed)
    wrenches = []
    for tick in range(1, 1001):
        bench.command(pressed + [0.0, 1e-3 * speed * tick, 0.0])
        bench.step(1e-3)
        wrenches.append(bench.contact_wrench())
    # A quick one chatters.
    across, ahead, _ = np.mean(wrenches[200:], axis=0)
    assert across == pytest.approx(-push, rel=0.05)
    assert ahead / across == pytest.approx(friction, rel=0.02)


def test_a_moved_hand_lags_by_nothing_in_free_motion():
    """Its dampers move with it: the card is where the hand is commanded, at any steady speed."""
    bench, speed = Bench(MEDIUM), 0.02
    bench.place(np.array([0.0, -0.1, 0.0]))
    for tick in range(1, 201):
        bench.command(np.array([0.0, -0.1 + 0.01 * speed * tick, 0.0]))
        bench.step(0.01)
    assert bench.pose[1] == pytest.approx(-0.1 + speed * 2.0, abs=2e-5)
    assert bench.data.qvel[1] == pytest.approx(speed, rel=1e-3)


def test_hand_as_made_gives_by_its_own_springs_and_shows_its_sensors_errors():
    errors = ChannelSpec(
        bias=(0.4, -0.3, 0.5, 0.01, 0.02, -0.02),
        scale=(1.01, 0.99, 1.0, 1.0, 1.0, 1.02),
        cross=tuple(tuple(row) for row in np.full((6, 6), 0.01) - 0.01 * np.eye(6)),
        drift=(0.2, 0.0, 0.0, 0.0, 0.0, 0.0),
        warm_up=0.5,
    )
    hand = HandAsMade(np.array([1.2, 0.8, 1.0, 1.0, 1.0, 0.9]), np.ones(6), errors)
    shape, bench = shape_of(MEDIUM), Bench(MEDIUM, hand)
    drawn = Bench(MEDIUM)
    np.testing.assert_allclose(bench.stiffness, drawn.stiffness * hand.springs)
    pose = pose_in_state(shape, 2, 1, 0.08, 0.008)
    contacts = contacts_of(shape, pose, 2, 1)
    wanted = wrench_cone(contacts, shape.friction) @ np.ones(2)
    press(bench, pose, wanted)
    assert bench.true_state() == (2, 1)
    np.testing.assert_allclose(bench.pose[:2], pose[:2], atol=1e-4)
    fx, fy, moment = bench.contact_wrench()
    # Zero and what has drifted after a quarter of a second, half the time to be warm.
    warm = 0.2 * (1.0 - np.exp(-bench.data.time / 0.5))
    np.testing.assert_allclose(bench.zero, [0.4 + warm, -0.3, -0.02])
    shown = [
        1.01 * fx + 0.01 * (fy + moment),
        0.99 * fy + 0.01 * (fx + moment),
        1.02 * moment + 0.01 * (fx + fy),
    ]
    np.testing.assert_allclose(bench.sensed - bench.zero, shown, atol=2e-4)


def test_hands_are_made_within_the_tolerances_and_not_at_all_as_drawn():
    assert HandAsMade.drawn_from("ideal", np.random.default_rng(0)) is None
    hand = HandAsMade.drawn_from("default", np.random.default_rng(0))
    other = HandAsMade.drawn_from("default", np.random.default_rng(1))
    assert hand is not None and other is not None
    assert np.all(np.abs(hand.springs - 1.0) <= 0.3) and np.ptp(hand.springs) > 0.0
    assert not np.array_equal(hand.springs, other.springs)
    assert np.max(np.abs(hand.sensor.bias)) <= 1.0


def test_sensor_that_is_off_is_tared_before_it_guides():
    result = run_insertion(InsertionJob(HARD, 3, True, 7, realism="default"))
    assert result.success and result.peak < 5.0


def test_states_of_one_job_are_counted():
    result = run_states(StateJob(3, MEDIUM, 1, poses=2, samples=2))
    assert result.classified.sum() == 4
    assert result.location_mm.shape == (6, 4)
    assert result.location_mm[0].max() < 0.2


def test_force_guides_the_card_in_where_straight_ahead_fails():
    by_force = run_insertion(InsertionJob(HARD, 3, True, 7))
    straight = run_insertion(InsertionJob(HARD, 3, False, 7))
    assert by_force.offset == straight.offset
    # It does get as far as the slot's face, and presses on it.
    assert by_force.success and not straight.success and straight.reason == "force"
    assert by_force.peak < 5.0
    assert straight.peak < 10.0


@pytest.mark.slow
def test_a_slot_narrower_than_the_card_is_given_up_with_little_force():
    result = run_insertion(InsertionJob(ch5_contact.IMPOSSIBLE, 1, True, 3, trace=True))
    assert not result.success and result.finite
    assert result.peak < 5.0
    assert result.reason
    assert np.all(np.isfinite(result.course))


@pytest.mark.slow
def test_small_run_is_measured_and_recorded(tmp_path, monkeypatch):
    few = dataclasses.replace(CARD_AND_SLOT, slot_widths=(HARD, MEDIUM))
    monkeypatch.setattr(ch5_contact, "CARD_AND_SLOT", few)
    monkeypatch.setattr(ch5_contact, "RINGS", (3,))
    brief = functools.partial(StateJob, poses=2, samples=2)
    monkeypatch.setattr(ch5_contact, "StateJob", brief)
    monkeypatch.setattr(seating, "FRICTIONS", (0.3,))
    monkeypatch.setattr(seating, "RINGS", (1,))
    options = ch5_contact.Options(seeds=1, jobs=1, out=tmp_path, record=True)
    output = Output("ch5-contact", options)
    ch5_contact.run(options, output)
    output.finish()
    folder = tmp_path / "ch5-contact"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["states_classified_fraction"]["n"] > 0
    assert measured["success/impossible"]["mean"] == 0.0
    for way in ("guided", "straight", "spiral"):
        assert measured[f"success/{way}/guides"] == measured[f"success/{way}/0.3/1"]
        assert measured[f"success/{way}/guides"]["n"] == 3
    assert 1.5 < measured["snap_force_n"]["median"] < 6.0
    assert (folder / "figures" / "seatings.png").is_file()
    assert (folder / "figures" / "figure_a-7.png").is_file()
    assert (folder / "run.rrd").stat().st_size > 1000
