"""The simulated mechanism settles at the exact kinematics' pose, and switches as commanded."""

import numpy as np
import pytest

from controllers.braid.arm.chain import forward
from controllers.braid.arm.stage import LEGS, STATES, state_poses
from controllers.braid.bus.drive import WireDrive, word_bits
from experiments.appe.mechanism.bench import GEOMETRY, ideal_tip, make_bench
from experiments.appe.mechanism.mechanism import Options
from experiments.appe.mechanism.trial import (
    ArmTrial,
    pull,
    run_sag,
    run_words,
    settle_states,
)
from experiments.harness.contract import OptionError
from models.braid.build import BraidConfig
from models.datasheets import BRAID
from perception.geometry.gravity import GRAVITY


def test_an_arm_put_into_a_word_closes_all_its_loops_at_the_pose_of_the_kinematics():
    bench = make_bench(BraidConfig(4))
    rng = np.random.default_rng(1)
    for word in rng.integers(0, STATES, (5, 4)):
        bench.heat(np.ones((4, LEGS, 2)))
        bench.put(word)
        assert not np.any(bench.data.ctrl)
        np.testing.assert_allclose(bench.tip(), ideal_tip(word), atol=1e-12)
        np.testing.assert_allclose(
            ideal_tip(word), forward(state_poses(GEOMETRY), word), atol=1e-12
        )
        gaps = bench.data.efc_pos[: bench.data.ne]
        assert len(gaps) == 3 * 3 * 4
        assert np.abs(gaps).max() < 1e-12
        np.testing.assert_array_equal(bench.bits(), word_bits(word))


def test_wires_bring_a_stage_within_a_thousandth_of_r_of_each_state():
    place, angle = settle_states(flexures=True)
    assert place.max() < 1e-3 * BRAID.radius
    assert angle.max() < 1e-3
    ideal, _ = settle_states(flexures=False)
    assert ideal.max() < 1e-9 * BRAID.radius


@pytest.mark.parametrize("extend", [True, False])
def test_a_leg_holds_against_0_9_of_the_barrier_and_switches_at_1_1(extend):
    bench = make_bench(BraidConfig(1, head=False), gravity=False)
    assert not pull(bench, 2, extend, 0.9 * BRAID.barrier)
    assert pull(bench, 2, extend, 1.1 * BRAID.barrier)


def test_a_straight_arm_sinks_as_its_weight_presses_its_detents_in():
    """Each well is a spring of 2 k: legs share the weight above, the sum of all is the sag."""
    bench = make_bench(BraidConfig(2, flexures=False))
    word = np.array([7, 7])
    bench.put(word)
    bench.step(1.0)
    model = bench.model
    head = model.body("braid/stereo_head").mass[0]
    names = [model.body(body).name for body in range(model.nbody)]
    platform = model.body("braid/stage2").mass[0]
    legs = sum(model.body(n).mass[0] for n in names if n.startswith("braid/stage2_leg"))
    top = head + platform
    # Rods stand on the disc below, sleeves and platform on the wells.
    rods = sum(model.body(n).mass[0] for n in names if "stage2_leg" in n and n.endswith("_rod"))
    above = top + legs - rods
    below = above + rods + platform + legs - rods
    # Pressed in by d, a well has (1 - 1.5 d / h) of its stiffness.
    linear = GRAVITY * np.array([above, below]) / 3.0 / (2.0 * BRAID.detent)
    expected = float(np.sum(linear * (1.0 + 1.5 * linear / BRAID.half_stroke)))
    sag = ideal_tip(word)[2] - bench.tip()[2]
    assert sag == pytest.approx(expected, rel=1e-3)
    assert bench.loads().max() > 0.0


def test_words_change_bit_by_bit_without_a_wrong_one():
    result = run_words(ArmTrial(stages=3, seed=0, words=4, at_once=9))
    assert result.errors.wrong.sum() == 0
    assert result.changed.sum() > 4
    assert result.warnings == 0


def test_longer_arms_sag_more():
    short, long = (run_sag(ArmTrial(n, 0, 0, True)) for n in (1, 3))
    assert not short.wrong.any()
    assert not long.wrong.any()
    assert long.sag.max() > 5.0 * short.sag.max()


def test_half_the_step_gives_the_same_arm():
    tips = []
    for step in (5e-4, 2.5e-4):
        bench = make_bench(BraidConfig(2))
        bench.model.opt.timestep = step
        word = np.array([0, 0])
        bench.put(word)
        drive = WireDrive(word)
        drive.change(np.array([5, 2]))
        bench.drive(drive)
        assert np.abs(bench.data.qvel).max() < 1e-5
        tips.append(bench.tip())
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-6)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("stages", 9, "--stages 9"),
        ("words", 0, "--words: expected at least 1, got 0"),
        ("at_once", 0, "--at-once: expected at least 1, got 0"),
    ],
)
def test_arms_and_words_that_cannot_be_run_are_refused(option, value, message):
    with pytest.raises(OptionError, match=message):
        Options(**{option: value})
