"""The bench presses the states that geometry constructs, and force guides the card in."""

import dataclasses
import functools
import json

import numpy as np
import pytest

from controllers.insertion.contact import STATES, contacts_of, pose_in_state, wrench_cone
from experiments.ch5 import contact as ch5_contact
from experiments.ch5.contact_bench import Bench, press, shape_of
from experiments.ch5.contact_trial import InsertionJob, StateJob, run_insertion, run_states
from experiments.harness.output import Output
from models.datasheets import CARD_AND_SLOT

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
    bench.command(np.array([0.0, -0.02, 0.0]))
    bench.step(0.05)
    assert bench.true_state() == (0, 0)
    np.testing.assert_allclose(bench.sensed, 0.0, atol=1e-6)


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
    options = ch5_contact.Options(seeds=1, jobs=1, out=tmp_path, record=True)
    output = Output("ch5-contact", options)
    ch5_contact.run(options, output)
    output.finish()
    folder = tmp_path / "ch5-contact"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["states_classified_fraction"]["n"] > 0
    assert measured["success/impossible"]["mean"] == 0.0
    assert (folder / "figures" / "figure_a-7.png").is_file()
    assert (folder / "run.rrd").stat().st_size > 1000
