"""Table 4-1: the tests, their orderings, and that any number of processes gives the same."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest

from controllers.placement.planar.arc_search import search_rings
from controllers.placement.planar.search import (
    PlanarTask,
    RingCandidates,
    best_view,
    view_from,
)
from controllers.placement.planar.sight import KnownSpace
from controllers.placement.task import Lens, Occluder, Target
from experiments.ch4.montecarlo import montecarlo as ch4_montecarlo
from experiments.ch4.montecarlo.montecarlo import CHUNK, TABLE_4_1, Options, run, succeeded
from experiments.ch4.montecarlo.orderings import compare_all, second_chance
from experiments.ch4.montecarlo.scenario import SCENARIO, ObstacleWorld, draw_worlds
from experiments.ch4.montecarlo.sight import focus
from experiments.ch4.montecarlo.trial import (
    DIRECTIONS,
    FIXED,
    OPTIMAL,
    RANDOM,
    RINGS,
    GuidanceJob,
    GuidedTests,
    draw_chance,
    guide,
    run_tests,
)
from experiments.harness.output import Output
from models.compose import ROUGH, RobotPlacement, make_model, settle
from models.datasheets import CAMERA, ROVER
from twin.robot import Command, WheelMode
from twin.simulation import Simulation

SHAPE = (3, 3, 3, 2)


def drawn_success(n, share, seed=0):
    return np.random.default_rng(seed).random((n, *SHAPE)) < share


def test_thesis_optimal_rows_are_an_independent_second_chance():
    optimal = TABLE_4_1[:, :, 0] / 100.0
    law = 1.0 - (1.0 - optimal[..., 0]) ** 2
    assert np.abs(law - optimal[..., 1]).max() < 0.012
    assert TABLE_4_1[1, 1, 0, 1] == 86  # density 20 %, tolerance 10 %, with secondary
    assert TABLE_4_1[2, 0, 1, 0] == 5  # density 35 %, tolerance 20 %, random, without


def test_a_planted_wrong_order_is_found_and_a_tie_is_not():
    success = np.repeat(drawn_success(300, 0.5)[:, :1, :1, :1, :1], 3, axis=1)
    success = np.broadcast_to(success, (300, *SHAPE)).copy()
    assert not any(c.violated for c in compare_all(success))
    success[:40, 2, 1, 0, 0] = True
    success[:40, 1, 1, 0, 0] = False
    violated = [(c.kind, c.better, c.worse) for c in compare_all(success) if c.violated]
    assert ("density", "optimal/20/10/primary", "optimal/35/10/primary") in violated
    assert {kind for kind, _, _ in violated} <= {"density", "tolerance", "placement", "secondary"}
    assert all("optimal/20/10/primary" in v or "optimal/35/10/primary" in v for v in violated)


def test_all_neighbours_in_the_table_are_compared():
    kinds = [c.kind for c in compare_all(drawn_success(10, 0.5))]
    counts = {kind: kinds.count(kind) for kind in set(kinds)}
    assert counts == {"density": 36, "tolerance": 36, "placement": 36, "secondary": 27}


def test_independent_targets_keep_the_law_of_the_second_chance():
    success = drawn_success(20000, 0.3)
    success[..., 1] = success[..., 0] | drawn_success(20000, 0.3, seed=1)[..., 0]
    assert np.abs(second_chance(success)).max() < 0.015


def test_success_is_within_the_clearance_and_seen():
    error = np.zeros((1, 3, 3, 2))
    error[0, 0, 0, 0] = 0.0999 * SCENARIO.width
    error[0, 1, 0, 0] = 0.1001 * SCENARIO.width
    sightings = np.ones((1, 3, 3, 2))
    sightings[0, 2, 0, 0] = 0
    found = succeeded(GuidedTests(error, sightings, *[np.empty(0)] * 4))[0, :, :, 0, 0]
    assert found.tolist() == [[True, False, False], [False, False, False], [False, False, False]]


@pytest.mark.slow
def test_an_object_that_is_never_seen_drifts_over_its_whole_path():
    chance = draw_chance(1)
    blocked = ObstacleWorld(np.zeros((0, 6, 2)), np.ones((240, 240)))
    expected = SCENARIO.prior * chance.constants[0]
    expected += SCENARIO.drift * SCENARIO.start * chance.slopes[0]
    for placement in (OPTIMAL, RANDOM, FIXED):
        error, track = guide(SCENARIO, blocked, chance, placement, True)
        assert error == pytest.approx(expected)
        assert not track[:, 3].any()
        assert np.isnan(track[:, 1]).all()


@pytest.mark.slow
def test_arrival_error_has_the_variance_that_the_sightings_predict():
    # In the open all periods are seen; what is left is the last weighted error and a short drift.
    world = ObstacleWorld(np.zeros((0, 6, 2)), np.zeros((240, 240)))
    ratios = []
    for seed in range(150):
        chance = draw_chance(seed)
        _, track = guide(SCENARIO, world, chance, OPTIMAL, False)
        assert (track[:, 3] == 1).all()
        ratios.append(track[1:, 4] / track[1:, 5])
    np.testing.assert_allclose(np.mean(np.square(ratios), axis=0), 1.0, atol=0.5)


@pytest.mark.slow
def test_optimal_pose_is_the_exhaustive_optimum_of_the_same_task():
    chance = draw_chance(8)
    world = draw_worlds(chance.candidates)[1]
    _, track = guide(SCENARIO, world, chance, OPTIMAL, True)
    half, marker = 0.5 * SCENARIO.side, SCENARIO.marker
    for gap, x, y, _, _, sigma in track[[0, len(track) // 2, -1]]:
        near, far = focus(SCENARIO, gap, sigma)
        reach = [marker, 0.5 * gap + marker]
        outline = np.array([[sx, sy] for sx, sy in itertools.product((-1, 1), repeat=2)]) * reach
        side = 0.5 * SCENARIO.width + SCENARIO.ear
        targets = tuple(
            Target(name, np.array([s * side, 0.5 * gap]), np.array([0.0, 1.0]), outline, relation)
            for name, s, relation in (("primary", 1, 0.0), ("secondary", -1, SCENARIO.relation))
        )
        body = np.array([[-1, 0], [1, 0], [1, 1], [-1, 1]]) * [0.5 * SCENARIO.width, 1.0]
        body = body * [1.0, SCENARIO.length] + [0.0, gap]
        occluders = [Occluder(f"hexagon {i}", c) for i, c in enumerate(world.corners)]
        lens = Lens(CAMERA.field_of_view[0], CAMERA.width, near, far)
        space = KnownSpace(world.occupied, SCENARIO.cell, (-half, -half))
        task = PlanarTask(targets, lens, (*occluders, Occluder("object", body)), space)
        best = best_view(task, RingCandidates(RINGS, DIRECTIONS), search_rings, refine=False)
        chosen = view_from(
            dataclasses.replace(task, lens=dataclasses.replace(lens, near=near * (1 - 1e-9))),
            np.array([x, y]),
        )
        assert chosen.rating == pytest.approx(best.rating, rel=1e-6)


@pytest.mark.slow
def test_random_cameras_move_only_when_they_see_nothing_and_fixed_ones_never():
    moved = 0
    for seed in range(10):
        chance = draw_chance(seed)
        world = draw_worlds(chance.candidates)[2]
        _, track = guide(SCENARIO, world, chance, RANDOM, True)
        first = track[0, 1:3].copy()
        changes = np.any(np.diff(track[:, 1:3], axis=0) != 0.0, axis=1)
        assert not changes[track[:-1, 3] > 0].any()
        moved += changes.sum()
        _, track = guide(SCENARIO, world, chance, FIXED, True)
        assert np.all(track[:, 1:3] == track[0, 1:3])
        np.testing.assert_array_equal(track[0, 1:3], first)
        _, track = guide(SCENARIO._replace(stays=0.0), world, chance, RANDOM, True)
        restless = np.any(np.diff(track[:, 1:3], axis=0) != 0.0, axis=1)
        assert restless.mean() > 0.9
    assert moved > 10


@pytest.mark.slow
def test_a_test_does_not_depend_on_the_others_of_its_job():
    together, _ = run_tests(GuidanceJob((3, 4), {}))
    alone, _ = run_tests(GuidanceJob((4,), {}))
    for name, values in vars(alone).items():
        np.testing.assert_array_equal(values[0], getattr(together, name)[1])


@pytest.mark.slow
@pytest.mark.chosen_seed  # No option reaches the other processes.
def test_any_number_of_processes_gives_the_same_bits(tmp_path):
    found = []
    for jobs in (1, 2):
        options = Options(seeds=CHUNK + 5, jobs=jobs, out=tmp_path / str(jobs))
        output = Output("ch4-montecarlo", options)
        run(options, output)
        output.finish()
        directory = tmp_path / str(jobs) / "ch4-montecarlo"
        metrics = json.loads((directory / "metrics.json").read_text())
        assert metrics["measured"].pop("tests_per_second") > 0.0
        tables = [file.read_bytes() for file in sorted((directory / "tables").iterdir())]
        found.append((metrics["measured"], tables))
    assert found[0] == found[1]
    measured = found[0][0]
    for tolerance in (20, 10, 1):
        key = f"20/{tolerance}/primary"
        optimal, fixed = (measured[f"success/{p}/{key}"]["mean"] for p in ("optimal", "fixed"))
        assert optimal > fixed


@pytest.mark.slow
def test_drift_is_what_a_rover_on_rough_ground_shows():
    # The scenario's 2.5 % is of 24 fields; four leave it uncertain by about a third.
    ahead, distance, speed = 0.4, 0.3, 0.1
    ratios = []
    for seed in range(4):
        field = dataclasses.replace(ROUGH, seed=seed, texture_pixels=64)
        model = make_model(field, [RobotPlacement("rover1")])
        simulation = Simulation(model, ["rover1"], seed=seed, data=settle(model))
        rover, body = simulation.robots["rover1"], simulation.data.body("rover1/chassis")
        rover.activate()
        start, forward = body.xpos[:2].copy(), _heading(body)
        wheels = np.full(4, speed / ROVER.wheel_radius)
        for _ in range(round(distance / speed / simulation.period)):
            rover.command(Command(wheels=wheels, wheel_mode=WheelMode.SPEED))
            simulation.tick()
        moved = body.xpos[:2] - start + ahead * (_heading(body) - forward)
        ratios.append((forward[0] * moved[1] - forward[1] * moved[0]) / distance)
    measured = math.sqrt(np.mean(np.square(ratios)))
    assert 0.4 * SCENARIO.drift < measured < 2.5 * SCENARIO.drift


def _heading(body):
    forward = body.xmat.reshape(3, 3)[:2, 1]
    return forward / np.linalg.norm(forward)


def test_quick_and_full_runs_share_their_first_tests():
    quick, full = Options(quick=True), Options()
    counts = ch4_montecarlo.QUICK_TESTS, ch4_montecarlo.TESTS
    assert full.job_seeds(*counts[::-1])[: counts[0]] == quick.job_seeds(*counts[::-1])
