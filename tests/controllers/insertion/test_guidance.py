"""Guidance arrives as it was sent, to its quantisation steps, or not at all."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.guidance import Guidance, GuidanceError, GuidanceLink, unpack
from models.datasheets import CLOCK, HARSH_CLOCK, HARSH_RADIO, RADIO
from perception.geometry.se3 import adjoint
from twin.hardware.emulator.modem import ModemConfig, VirtualModems
from twin.hardware.radio.framed_radio import FramedLink
from twin.link import MESSAGE_LIMIT, Polled
from twin.robot_clock import RobotClock

PLACE_STEP, TURN_STEP = 2e-5, 1e-4


def drawn(rng: np.random.Generator) -> Guidance:
    """A look with a covariance such as a pair gives: correlated, and hundredfold in its sizes."""
    pose = RigidTransform.from_components(
        rng.uniform(-0.3, 0.3, 3), Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3))
    )
    deviations = 10.0 ** np.array([-2.5] * 3 + [-3.5] * 3) * rng.uniform(0.3, 3.0, 6)
    lift = adjoint(RigidTransform.from_translation([0.0, 0.0, 0.5]))
    covariance = lift @ np.diag(deviations**2) @ lift.T
    return Guidance(float(rng.uniform(0.0, 90.0)), True, True, pose, covariance)


def test_message_encodes_the_pose_to_half_a_step_and_fits_a_frame():
    rng = np.random.default_rng(0)
    for _ in range(60):
        original = drawn(rng)
        message = original.pack()
        assert len(message) <= MESSAGE_LIMIT
        received = unpack(message)
        assert original.transform_slot_to_card is not None
        assert received.transform_slot_to_card is not None
        assert received.card_seen and received.slot_seen
        assert received.time == pytest.approx(original.time, abs=0.51e-3)
        place = (
            received.transform_slot_to_card.translation
            - original.transform_slot_to_card.translation
        )
        assert np.abs(place).max() <= 0.5 * PLACE_STEP + 1e-12
        turn = received.transform_slot_to_card.rotation.as_rotvec()
        turn = turn - original.transform_slot_to_card.rotation.as_rotvec()
        assert np.abs(turn).max() <= 0.5 * TURN_STEP + 1e-12


def test_covariance_arrives_to_half_precision_and_positive():
    rng = np.random.default_rng(1)
    for _ in range(60):
        original = drawn(rng)
        received = unpack(original.pack()).covariance
        np.testing.assert_allclose(received, received.T, atol=1e-18)
        assert np.linalg.eigvalsh(received).min() > 0.0
        # Eleven bits of each number, on the scale of its row and column.
        scale = np.sqrt(np.outer(np.diag(original.covariance), np.diag(original.covariance)))
        assert np.abs((received - original.covariance) / scale).max() < 2e-3


def test_covariance_too_small_or_too_large_for_its_numbers_stays_positive_and_finite():
    for size in (0.0, 1e-16, 1e-2, 1.0, 1e6):
        original = Guidance(1.0, True, True, RigidTransform.identity(), size * np.eye(6))
        received = unpack(original.pack()).covariance
        assert np.isfinite(received).all() and np.linalg.eigvalsh(received).min() > 0.0


@pytest.mark.parametrize("card", [False, True])
@pytest.mark.parametrize("slot", [False, True])
def test_message_without_a_pose_reports_which_bodies_were_seen(card, slot):
    received = unpack(Guidance(2.0, card, slot, None, np.zeros((6, 6))).pack())
    assert (received.card_seen, received.slot_seen) == (card, slot)
    assert received.transform_slot_to_card is None
    np.testing.assert_array_equal(received.covariance, 0.0)


def test_what_cannot_be_sent_is_refused():
    far = RigidTransform.from_translation([0.7, 0.0, 0.0])
    near, identity = RigidTransform.identity(), 1e-6 * np.eye(6)
    with pytest.raises(GuidanceError, match="0.65 m"):
        Guidance(1.0, True, True, far, identity).pack()
    with pytest.raises(GuidanceError, match="not finite"):
        Guidance(1.0, True, True, near, np.full((6, 6), np.nan)).pack()
    with pytest.raises(GuidanceError, match="not finite"):
        Guidance(float("nan"), True, True, near, identity).pack()


def test_what_is_no_such_message_is_refused():
    message = Guidance(1.0, True, True, RigidTransform.identity(), 1e-6 * np.eye(6)).pack()
    for wrong in (b"", message[:-1], message + b"\0", b"\x13" + message[1:]):
        with pytest.raises(GuidanceError, match="no guidance message"):
            unpack(wrong)
    infinite = message[:-2] + b"\x7c\x00"  # the last half is infinite
    with pytest.raises(GuidanceError, match="covariance"):
        unpack(infinite)


def test_radio_with_byte_errors_loses_messages_but_never_changes_one():
    rng = np.random.default_rng(2)
    modems = VirtualModems(ModemConfig(error_rate=3e-3), rng)
    master, slave = (FramedLink(end, rng) for end in modems.ends)
    sent: list[bytes] = []
    received: list[bytes] = []
    for tick in range(60 * 100):
        modems.time = 0.01 * tick
        if tick % 25 == 0:
            sent.append(drawn(rng).pack())
            master.send_latest(sent[-1])
        master.poll()
        received += slave.poll().messages
    assert 0.6 * len(sent) < len(received) < len(sent)
    order = [sent.index(message) for message in received]
    assert order == sorted(order)
    assert slave._parser.rejected > 0


@pytest.mark.parametrize(
    ("radio", "sheet"), [(RADIO, CLOCK), (HARSH_RADIO, HARSH_CLOCK)], ids=["default", "harsh"]
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_receiver_knows_when_images_were_taken_though_the_clocks_disagree(radio, sheet, sign):
    """Five minutes in which the clocks drift apart, as far as they may."""
    clocks = RobotClock(sheet.offset, sign * sheet.drift), RobotClock(0.0, -sign * sheet.drift)
    rng = np.random.default_rng(3)
    modems = VirtualModems(ModemConfig.of(radio), rng)
    master, slave = (GuidanceLink(FramedLink(end, rng)) for end in modems.ends)
    taken, errors, excess, late = 0.0, [], [], []
    for tick in range(300 * 100):
        modems.time = 0.01 * tick
        there, here = (clock.read(modems.time) for clock in clocks)
        guidance = None
        if tick % 25 == 0:  # A picture takes a quarter of a second to its use.
            taken = modems.time - 0.25
            stamp = clocks[0].read(taken)
            guidance = Guidance(stamp, True, True, RigidTransform.identity(), np.eye(6) * 1e-6)
        master.send(guidance, there)
        for view in slave.receive(here):
            errors.append(view.time - clocks[1].read(taken))
            excess.append(abs(errors[-1]) - slave.offset_limit)
            late.append(modems.time - taken)
    assert len(errors) > 0.9 * (1.0 - radio.packet_loss) * 1200
    assert max(excess) < 1e-3  # The stamp's own rounding.
    # At the start an answer may wait behind guidance.
    settled = np.abs(errors[20:])
    assert np.max(late) > 0.3 > 30 * np.max(settled) and np.median(settled) < 5e-3
    # Half the round trip of a question: 17 bytes and the modem each way, polled every tick.
    assert slave.offset_limit < 17 / 960 + radio.delay + 0.02 + 0.01


def test_slot_and_card_wait_for_the_first_answer_and_nothing_else_is_answered():
    sent: list[bytes] = []

    class Ear:
        """A link that hears one message and notes what is sent."""

        def __init__(self, *heard):
            self._heard = list(heard)

        def send_latest(self, message):
            sent.append(message)

        def poll(self):
            heard, self._heard = self._heard, []
            return Polled(heard, [])

        send = None

    view = Guidance(1.0, True, True, RigidTransform.identity(), 1e-6 * np.eye(6)).pack()
    slave = GuidanceLink(Ear(view))
    assert slave.receive(7.0) == [] and np.isnan(slave.offset) and slave.offset_limit == np.inf
    (question,) = sent
    master = GuidanceLink(Ear(question))
    master.send(None, 5.0)
    slave._link = Ear(sent[-1], view)
    (seen,) = slave.receive(7.2)
    assert slave.offset == pytest.approx(5.0 - 7.1) and seen.time == pytest.approx(3.1)
    assert slave.offset_limit == pytest.approx(0.1 + 1e-3)
    with pytest.raises(GuidanceError, match="0x15"):
        GuidanceLink(Ear(view)).send(None, 5.0)
