"""What the rovers say over the radio: as it was meant, or refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.mapping.messages import (
    MapDelta,
    PoseMessage,
    WrenchMessage,
    pack_map_change,
    unpack,
)
from twin.link import RadioError

pytestmark = pytest.mark.virtual_time

TIMES = st.floats(-1e3, 1e6)
ANGLES = st.floats(-100.0, 100.0)


def vector(most):
    return st.tuples(*[st.floats(-most, most)] * 3)


@given(
    st.integers(0, 255), TIMES, vector(32.7), st.tuples(ANGLES, ANGLES, ANGLES), st.floats(0, 65.5)
)
def test_pose_comes_back_within_half_a_step_in_20_bytes(robot, stamp, place, attitude, deviation):
    data = PoseMessage(robot, stamp, place, attitude, deviation).pack()
    back = unpack(data)
    assert len(data) == 20 and isinstance(back, PoseMessage)
    assert back.robot == robot
    assert [back.time, *back.position, back.deviation] == pytest.approx(
        [stamp, *place, deviation], abs=0.51e-3
    )
    for sent, got in zip(attitude, back.attitude):
        assert abs(math.remainder(sent - got, math.tau)) < 0.51 * math.pi / 2**15


@given(st.integers(0, 255), TIMES, vector(327.0), vector(32.7))
def test_wrench_comes_back_within_half_a_step(robot, stamp, force, moment):
    back = unpack(WrenchMessage(robot, stamp, force, moment).pack())
    assert isinstance(back, WrenchMessage)
    assert back.force == pytest.approx(force, abs=0.51e-2)
    assert [back.time, *back.moment] == pytest.approx([stamp, *moment], abs=0.51e-3)


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 255)), max_size=100))
def test_map_change_comes_back_whole_and_says_how_much_is_left(pairs):
    voxels, occupancies = [p[0] for p in pairs], [p[1] for p in pairs]
    messages = list(pack_map_change(2, 7, voxels, occupancies))
    parts = [unpack(message) for message in messages]
    assert all(len(message) <= 64 for message in messages)
    assert all(isinstance(part, MapDelta) and part.revision == 7 for part in parts)
    assert [int(v) for part in parts for v in part.voxels] == voxels
    assert [int(v) for part in parts for v in part.occupancies] == occupancies
    assert not parts or parts[-1].remaining == 0
    assert [part.remaining for part in parts] == [
        len(pairs) - sum(p.voxels.size for p in parts[: i + 1]) for i in range(len(parts))
    ]


def test_message_that_cannot_be_told_is_refused():
    good = PoseMessage(1, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    with pytest.raises(RadioError, match="position nan is not finite"):
        PoseMessage(1, 0.0, (math.nan, 0.0, 0.0), good.attitude, 0.0).pack()
    with pytest.raises(RadioError, match="attitude inf is not finite"):
        PoseMessage(1, 0.0, good.position, (0.0, math.inf, 0.0), 0.0).pack()
    with pytest.raises(RadioError, match="position 40.0 is not within"):
        PoseMessage(1, 0.0, (40.0, 0.0, 0.0), good.attitude, 0.0).pack()
    with pytest.raises(RadioError, match="3 voxels with 2 occupancies"):
        pack_map_change(1, 0, [1, 2, 3], [1, 2])
    for wrong in ([256], [-1], [0.5]):
        with pytest.raises(RadioError, match="occupancy is no integer within 0 to 255"):
            pack_map_change(1, 0, [1], wrong)
    with pytest.raises(RadioError, match="type 0x21 is unknown; known: 0x11, 0x12, 0x13"):
        unpack(b"\x21" + good.pack()[1:])
    for wrong in (good.pack()[:-1], good.pack() + b"\0", b"\x13\x01\0\0\0\0", b"\x13"):
        with pytest.raises(RadioError, match="wrong length"):
            unpack(wrong)
    with pytest.raises(RadioError, match="empty"):
        unpack(b"")
