"""Card, slot and hand carry the datasheet's numbers and behave as it says."""

import mujoco
import numpy as np
import pytest
from scipy import spatial

from models.card_and_slot.build import PAINT, build_bench
from models.datasheets import CARD_AND_SLOT, HAND, INCH, TABLE_2_2_TRUTH


@pytest.fixture(scope="module")
def bench() -> mujoco.MjModel:
    return build_bench(CARD_AND_SLOT.slot_widths[1]).compile()


def test_widths_are_those_of_the_thesis_and_leave_18_6_and_3_percent():
    assert CARD_AND_SLOT.card_width == pytest.approx(0.10795)
    room = [width / CARD_AND_SLOT.card_width - 1.0 for width in CARD_AND_SLOT.slot_widths]
    np.testing.assert_allclose(room, [0.18, 0.06, 0.03], atol=0.005)
    assert CARD_AND_SLOT.marker_diameter == pytest.approx(6.35e-3)


@pytest.mark.parametrize("width", [*CARD_AND_SLOT.slot_widths, 4.2 * INCH])
def test_distance_of_the_walls_is_the_slot_width(width):
    model = build_bench(width).compile()
    for name, side in (("left", -1.0), ("right", 1.0)):
        wall = model.geom(f"slot_{name}")
        assert wall.pos[0] - side * wall.size[0] == pytest.approx(side * width / 2.0)
        assert wall.pos[1] - wall.size[1] == pytest.approx(0.0)
        assert 2.0 * wall.size[1] == pytest.approx(CARD_AND_SLOT.slot_depth)


def test_card_is_a_plate_with_its_leading_edge_at_the_origin(bench):
    plate = bench.geom("card_plate")
    sheet = CARD_AND_SLOT
    edges = [sheet.card_width, sheet.card_length, sheet.card_thickness]
    np.testing.assert_allclose(2.0 * plate.size, edges)
    np.testing.assert_allclose(plate.pos, [0.0, -sheet.card_length / 2.0, 0.0])
    assert bench.body("card").mass[0] == pytest.approx(np.prod(edges) * sheet.card_density)
    for name in ("card_plate", "slot_left", "slot_right"):
        assert bench.geom(name).friction[0] == sheet.friction
        np.testing.assert_allclose(bench.geom(name).solref, [0.004, 1.0])


def test_card_and_slot_have_two_quarter_inch_markers_each_that_touch_nothing(bench):
    for body in ("card", "slot"):
        for index in (0, 1):
            marker = bench.geom(f"{body}_marker{index}")
            assert bench.body(marker.bodyid[0]).name == body
            shape = bench.mesh(int(marker.dataid[0]))
            first, count = int(shape.vertadr[0]), int(shape.vertnum[0])
            corners = bench.mesh_vert[first : first + count]
            assert 2.0 * corners.max() == pytest.approx(0.25 * INCH, rel=1e-3)
            # What the cameras see is a circle to a thousandth of its area.
            seen = spatial.ConvexHull(corners).volume / (2.0 * PAINT)
            assert seen == pytest.approx(np.pi * (0.125 * INCH) ** 2, rel=1e-3)
            assert marker.contype[0] == marker.conaffinity[0] == 0


def test_hand_gives_by_force_over_stiffness_in_all_six_directions(bench):
    data = mujoco.MjData(bench)
    load = np.array([1.0, -2.0, 0.5, 0.03, -0.02, 0.05])
    data.qfrc_applied[:] = load
    mujoco.mj_step(bench, data, nstep=3000)
    np.testing.assert_allclose(data.qpos[:3], load[:3] / HAND.stiffness, rtol=1e-6)
    np.testing.assert_allclose(data.qpos[3:], load[3:] / HAND.turn_stiffness, rtol=1e-6)


def test_stiffness_of_the_hand_is_the_rovers_in_pitch_at_the_reach():
    assert HAND.turn_stiffness == TABLE_2_2_TRUTH["k_pitch"] == 317.0
    assert HAND.stiffness * HAND.reach**2 == pytest.approx(317.0)
    assert HAND.damping * HAND.reach**2 == pytest.approx(1.5)


def test_bench_shaken_against_the_slot_for_a_second_gives_no_warning():
    shaken = build_bench(CARD_AND_SLOT.slot_widths[1]).compile()
    data = mujoco.MjData(shaken)
    rng = np.random.default_rng(0)
    for _ in range(100):
        shaken.qpos_spring[:2] = rng.uniform(-0.01, 0.01, 2)
        mujoco.mj_step(shaken, data, nstep=10)
    assert np.all(np.isfinite(data.qpos))
    assert all(warning.number == 0 for warning in data.warning)


@pytest.mark.parametrize("width", [0.0, -0.1, float("nan"), float("inf")])
def test_slots_without_a_width_are_refused(width):
    with pytest.raises(ValueError, match="slot width"):
        build_bench(width)


def test_negative_friction_is_refused():
    with pytest.raises(ValueError, match="friction -1"):
        build_bench(0.12, -1.0)
