"""Messages of the rovers: unpacked as they were packed, or refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.mapping.messages import PoseMessage, WrenchMessage, unpack
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


def test_message_that_cannot_be_packed_or_unpacked_is_refused():
    good = PoseMessage(1, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    with pytest.raises(RadioError, match="position nan is not finite"):
        PoseMessage(1, 0.0, (math.nan, 0.0, 0.0), good.attitude, 0.0).pack()
    with pytest.raises(RadioError, match="attitude inf is not finite"):
        PoseMessage(1, 0.0, good.position, (0.0, math.inf, 0.0), 0.0).pack()
    with pytest.raises(RadioError, match="position 40.0 is not within"):
        PoseMessage(1, 0.0, (40.0, 0.0, 0.0), good.attitude, 0.0).pack()
    with pytest.raises(RadioError, match="type 0x21 is unknown; known: 0x11, 0x12"):
        unpack(b"\x21" + good.pack()[1:])
    for wrong in (good.pack()[:-1], good.pack() + b"\0", b"\x12"):
        with pytest.raises(RadioError, match="wrong length"):
            unpack(wrong)
    with pytest.raises(RadioError, match="empty"):
        unpack(b"")
