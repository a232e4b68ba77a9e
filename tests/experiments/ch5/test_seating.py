"""Insertions into card guides on the bench: three ways, from the same misalignments."""

import dataclasses
import math

import numpy as np
import pytest

from experiments.ch5.contact.seating_trial import (
    MOST_FORCE,
    RINGS,
    WAYS,
    WIDEST,
    BySpiral,
    SeatingJob,
    draw_misalignment,
    run_seating,
)
from models.datasheets import CARD_GUIDE

JOB = SeatingJob(CARD_GUIDE.clearances[1], 0.3, 1, "guided", 2)


def test_misalignments_lie_in_their_third_and_are_the_same_for_all_ways():
    for ring in RINGS:
        job = dataclasses.replace(JOB, ring=ring)
        shares = np.array(
            [draw_misalignment(job, np.random.default_rng(seed)) / WIDEST for seed in range(200)]
        )
        sizes = np.abs(shares)
        assert (ring - 1) / 3 <= sizes.min() and sizes.max() <= ring / 3
        assert np.all(np.abs(np.mean(shares, axis=0)) < 0.15)


def test_by_force_the_card_snaps_in_and_is_seated_where_straight_ahead_it_is_not():
    results = {way: run_seating(dataclasses.replace(JOB, ring=3, way=way)) for way in WAYS}
    guided = results["guided"]
    assert guided.success and not results["straight"].success
    assert guided.snap == pytest.approx(CARD_GUIDE.snap, rel=0.3)
    assert guided.depth == pytest.approx(CARD_GUIDE.depth, abs=1e-3)
    assert guided.peak < MOST_FORCE < results["straight"].peak
    assert math.isnan(results["straight"].snap)


@pytest.mark.parametrize("way", WAYS)
def test_a_card_that_is_hardly_misaligned_is_seated_in_every_way(way):
    assert run_seating(dataclasses.replace(JOB, way=way)).success


def test_a_made_hand_differs_from_the_drawn_one_and_finer_physics_change_little():
    drawn, made, fine = (
        run_seating(dataclasses.replace(JOB, **change))
        for change in ({}, {"realism": "default"}, {"fine": True})
    )
    assert drawn.success and made.success and fine.success
    assert made.peak != drawn.peak
    assert fine.snap == pytest.approx(drawn.snap, rel=0.1)


def test_a_spiral_searches_no_farther_than_its_reach_with_turns_as_close_as_its_pitch():
    search = BySpiral(np.array([0.0, -0.001, 0.0]))
    places = []
    while not search.over:
        place = search.step(np.zeros(6) if len(places) < 60 else np.array([0, -1.2, 0, 0, 0, 0]))
        places.append(place[[0, 3]])
    radii = np.linalg.norm(places, axis=1)
    assert radii.max() == pytest.approx(BySpiral.reach, rel=0.05)
    # Nothing within its reach is farther from its course than a little over half a turn.
    grid = np.random.default_rng(0).uniform(-0.004, 0.004, (200, 2))
    apart = np.linalg.norm(grid[:, None] - np.array(places), axis=2).min(axis=1)
    assert apart.max() < 0.6 * BySpiral.pitch
