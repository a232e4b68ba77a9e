"""The slave: it brings the card to the slot by the master's views, then inserts it by force.

Vehicle and arm are one redundant chain: the arm keeps the card before the slot by the last views
and dead reckoning, at every servo tick, and the wheels bring the robot to where the arm has its
easy range, while it is still far. Close to the slot the wheels are at rest, and the arm alone moves
(thesis section 5.1: vision guides in classical visual servo control).
"""

import dataclasses
import enum
import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.card_arm import CardArm, inverse, pitch_of, planar, to_plane
from controllers.insertion.guidance import Guidance
from controllers.insertion.guide import GuideConfig, InsertionGuide, Phase
from controllers.insertion.seating import SeatingConfig, SeatingGuide, StraightSeating
from controllers.insertion.slot_belief import BeliefConfig, SlotBelief
from controllers.motion.base_motion import level_of
from controllers.motion.base_tilt import BaseTilt
from controllers.motion.driving import Odometry, SkidSteer
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from twin.robot import ArmMode, Command, Observation, WheelMode

_ELBOW = 3.0  # Rates beyond are of the other elbow, not of a step [rad/s].
_STILL = np.zeros(4)


class InsertionStage(enum.Enum):
    """Stage of the slave's insertion."""

    WAIT = "wait"
    APPROACH = "approach"
    ALIGN = "align"
    INSERT = "insert"
    DONE = "done"
    FAILED = "failed"


@dataclasses.dataclass(frozen=True)
class CardInserterConfig:
    """Speeds, tolerances and timeouts of the slave.

    Attributes:
        guide: Configuration of the force-guided insertion.
        seating: What the connector behind card guides asks for; None for a slot of plain walls.
        forced: Whether force guides the card into its connector; else it goes straight ahead.
        watched: Whether a master sees card and slot; else the slave goes by its map alone.
        belief: Configuration of the slot's pose estimate.
        reach: Distance of the card's edge ahead of the robot in the arm's easy range [m].
        stand_off: Card's distance before the mouth when vision hands over to force [m].
        speed: Largest speed of the wheels [m/s].
        slowing: Gain by which the wheels slow near their goal, speed over distance [1/s].
        turn: Largest turning rate of the robot [rad/s].
        card_speed: Speed at which the arm moves the card [m/s].
        card_turn: Turning rate at which the arm pitches the card [rad/s].
        near: Distance of the robot to its goal at which the wheels stop [m].
        aligned: Errors across and ahead [m] and turn [rad] within which the card is aligned.
        looks: Number of views in a row that have to show it aligned.
        crooked: Angle out of the slot's plane beyond which a card does not go into guides [rad]: it
            is that of the arm from the slot's line, which only the wheels can change.
        room: Distance that the robot then backs off, to drive onto the line anew [m].
        backings: Largest number of times that it does.
        patience: Time before the slot after which the card is inserted by the estimate [s].
        stale: Age of the last view beyond which the slave stops unless the slot's covariance is
            small enough for dead reckoning [s].
        known: Largest standard deviation of the slot's position for dead reckoning [m], and for an
            insertion by the estimate.
        lost: Age of the last view at which the insertion fails [s].
        first: Time without a first view after which it fails [s]; until then nothing moves.
        following: Share of the speeds until the master has seen card and slot together: till then
            its camera has to follow the card.
        settle: Time over which the wrench is tared [s].
        force_limit: Contact force at which everything stops [N].
        timeout: Longest time of the whole task [s].
        period: Servo tick [s].
    """

    guide: GuideConfig
    seating: SeatingConfig | None = None
    forced: bool = True
    watched: bool = True
    belief: BeliefConfig = dataclasses.field(default_factory=BeliefConfig)
    reach: float = 0.47
    stand_off: float = 0.015
    speed: float = 0.06
    slowing: float = 0.8
    turn: float = 0.25
    card_speed: float = 0.03
    card_turn: float = 0.15
    near: float = 0.006
    aligned: tuple[float, float] = (7e-4, math.radians(0.5))
    looks: int = 3
    crooked: float = math.radians(1.5)
    room: float = 0.25
    backings: int = 3
    patience: float = 12.0
    stale: float = 1.0
    known: float = 4e-3
    lost: float = 6.0
    first: float = 15.0
    following: float = 0.3
    settle: float = 0.5
    force_limit: float = 9.0
    timeout: float = 180.0
    period: float = 0.01


class CardInserter:
    """Drives wheels and arm of the slave, one step each servo tick.

    Args:
        config: Speeds, tolerances and timeouts.
        arm: Arm with the card.
        steer: Kinematics of the slave's wheels.
        transform_slot_to_robot: Prior transform from the slot to the robot, by the map.
        covariance: (6, 6) covariance of that transform, as a twist in the robot frame.
        base: Tilt dynamics of the robot under its arm, fed forward while force guides; None for a
            robot of constant tilt.

    Attributes:
        config: Speeds, tolerances and timeouts.
        stage: Stage of the slave.
        reason: Reason of the failure; empty without one.
        guide: Force guidance of the insertion; None before it begins.
        contact: (6,) force and moment on the card less the tare, card frame [N, N m].
        belief: Estimate of the slot's pose.
        error: (5,) error of the card from its stand-off by the last view and its own motion since,
            see `to_plane`; NaN before the first.
    """

    def __init__(
        self,
        config: CardInserterConfig,
        arm: CardArm,
        steer: SkidSteer,
        transform_slot_to_robot: RigidTransform,
        covariance: FloatArray,
        base: BaseTilt | None = None,
    ) -> None:
        self.config = config
        self.stage, self.reason = InsertionStage.WAIT, ""
        self.guide: InsertionGuide | None = None
        self.contact = np.zeros(6)
        self.belief = SlotBelief(transform_slot_to_robot, covariance, config.belief)
        self.error = np.full(5, np.nan)
        self._arm, self._steer, self._base = arm, steer, base
        self._odometry = Odometry(steer)
        self._levelled = False
        self._load = 0.0  # Force that the limit applies to [N].
        self._time, self._since, self._last_view = 0.0, 0.0, -math.inf
        self._good, self._both_seen = 0, False
        # Whether and how often the robot has backed off, and how far right of the slot's line the
        # arm's base then is to be [m].
        self._backings, self._backing, self._aside = 0, False, 0.0
        self._tare: list[FloatArray] = []
        self._offset = np.zeros(6)
        self._wanted = np.empty(0)  # Joint angles; empty before the first step.
        # At the hand-over to force: slot and up in the robot frame, and the arm's weight on it.
        self._slot = self.belief.slot_in_start
        self._up, self._weight = np.array([0.0, 0.0, 1.0]), np.zeros(6)

    @property
    def over(self) -> bool:
        """Whether the insertion has ended, in DONE or FAILED."""
        return self.stage in (InsertionStage.DONE, InsertionStage.FAILED)

    def step(self, seen: Observation, views: Sequence[Guidance]) -> Command:
        """Process an observation and received guidance, and return the next command.

        Args:
            seen: Observation of the slave.
            views: Guidance received by radio since the last step.
        """
        config = self.config
        self._time += config.period
        joints = seen.arm_angles, seen.arm_rates
        if not all(each.usable and np.isfinite(each.value).all() for each in joints):
            return self._fail("no arm angles", np.zeros(4), arm=False)
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        if not len(self._wanted):
            self._wanted = angles.copy()
        self._reckon(seen, angles)
        self._listen(views)
        self._feel(seen, angles)
        if not self.over and self._time > config.timeout:
            return self._fail("out of time", angles)
        if not self.over and self._load > config.force_limit:
            return self._fail("force", angles)
        if self.stage is InsertionStage.WAIT:
            if self._last_view > -math.inf or not self.config.watched:
                self._enter(InsertionStage.APPROACH)
            elif self._time > config.first:
                return self._fail("target not seen", angles)
            return self._hold()
        if self.stage in (InsertionStage.APPROACH, InsertionStage.ALIGN):
            return self._go(angles)
        if self.stage is InsertionStage.INSERT:
            return self._insert(angles)
        return self._hold()

    def stop(self, reason: str) -> None:
        """End the insertion as failed, for a reason from outside.

        Args:
            reason: Reason to report.
        """
        if not self.over:
            self.stage, self.reason = InsertionStage.FAILED, reason

    def _enter(self, stage: InsertionStage) -> None:
        self.stage, self._since, self._good = stage, self._time, 0

    def _fail(self, reason: str, angles: FloatArray, arm: bool = True) -> Command:
        # The first reason is reported, and a seated card stays seated.
        self.stop(reason)
        if arm:
            self._wanted = angles.copy()
        return self._hold() if arm else Command(wheel_mode=WheelMode.DUTY, arm_mode=ArmMode.DUTY)

    def _hold(self, wheels: FloatArray = _STILL, rates: FloatArray = _STILL) -> Command:
        return Command(wheels, self._wanted, WheelMode.SPEED, ArmMode.POSITION, rates)

    def _reckon(self, seen: Observation, angles: FloatArray) -> None:
        """Advance dead reckoning; tilt is relative to that of the start."""
        before, turned = self._odometry.distance, self._odometry.turned
        self._odometry.update(seen, self.config.period)
        if not self._levelled and seen.inclinometer.usable:
            # The map's prior was given in the robot's own frame.
            self.belief.slot_in_start = self._odometry.pose() @ self.belief.slot_in_start
            self._levelled = True
        if self.stage is InsertionStage.INSERT or self.over:
            return
        driven, turn = self._odometry.distance - before, self._odometry.turned - turned
        card = self._odometry.pose() @ self._arm.card_frame(angles)
        slip = self._odometry.slip()
        self.belief.note(seen.time, card, driven, turn, self.config.period, slip)

    def _listen(self, views: Sequence[Guidance]) -> None:
        for view in views if self.config.watched else ():
            if view.card_seen or view.slot_seen:
                self._last_view = self._time
            self._both_seen |= view.card_seen and view.slot_seen
            if self.stage is InsertionStage.INSERT or self.over or not self.belief.take(view):
                continue
            assert self.belief.transform_slot_to_card is not None
            self.error = to_plane(self.belief.transform_slot_to_card.inv().as_matrix())
            self.error[1] += self.config.stand_off
            self._good = self._good + 1 if self._is_aligned(self.error) else 0

    def _feel(self, seen: Observation, angles: FloatArray) -> None:
        """Estimate the contact wrench on the card, less its tare."""
        felt, inserts = np.full(6, np.nan), self.stage is InsertionStage.INSERT
        up = level_of(seen).specific_force / GRAVITY
        if not inserts:
            self._up = up
        if seen.arm_base_wrench.usable:
            felt = self._arm.contact(seen.arm_base_wrench.value, angles, up)
        self._load = 0.0
        if not np.all(np.isfinite(felt)):
            self.contact = np.full(6, np.nan if inserts else 0.0)
            return
        if self.stage is InsertionStage.ALIGN:
            self._tare = [*self._tare, felt][-round(self.config.settle / self.config.period) :]
            self._offset = np.mean(self._tare, axis=0)
        self.contact = felt - self._offset if self._tare else np.zeros(6)
        # A contact before the insertion must not be tared away.
        bringing = self.stage in (InsertionStage.APPROACH, InsertionStage.ALIGN)
        touched = felt if bringing else self.contact
        self._load = float(np.linalg.norm(touched[:3]))

    def _go(self, angles: FloatArray) -> Command:
        """Move the card to its stand-off before the slot, by wheels and arm."""
        config = self.config
        age = self._time - self._last_view if config.watched else 0.0
        if age > config.lost:
            return self._fail("target not seen", angles)
        if age > config.stale and self.belief.deviation() > config.known:
            return self._hold()
        slot = inverse(self._odometry.pose()) @ self.belief.slot_in_start
        aside, gap = self._to_place(slot)
        wheels = _STILL
        if self.stage is InsertionStage.APPROACH:
            self._backing &= gap < config.room - config.near
            wheels = self._wheels_to(aside, gap - config.room if self._backing else gap)
            if abs(gap) < config.near and not self._backing:
                self._enter(InsertionStage.ALIGN)
        # While the robot is far away, the card stays within easy reach of the arm.
        away = max(gap, 0.0) if self.stage is InsertionStage.APPROACH else 0.0
        rates = self._bring(slot, np.array([0.0, -config.stand_off - away, 0.0]))
        if self.stage is InsertionStage.ALIGN:
            waited = self._time - self._since > config.patience
            if waited and config.watched and self.belief.deviation() > config.known:
                # The master may see the slot all the time, and no card before it.
                return self._fail("target not seen", angles)
            card = to_plane(inverse(slot) @ self._arm.card_frame(angles))
            card[1] += config.stand_off
            shown = self._good >= config.looks if config.watched else self._is_aligned(card)
            if len(self._tare) * config.period >= config.settle - 1e-9 and (shown or waited):
                if self._is_crooked(float(card[4])):
                    self._back_off(float(card[4]))
                elif self._is_rolled(slot):
                    return self._fail("rolled", angles)
                else:
                    self._hand_over(slot)
        return self._hold(self._pace * wheels, rates)

    def _is_aligned(self, error: FloatArray) -> bool:
        """Return whether the card is at its stand-off, by its error (5,) as of `error`."""
        across, turn = self.config.aligned
        return bool(np.all(np.abs(error[:3]) < [across, across, turn]))

    def _is_crooked(self, yaw: float) -> bool:
        """Return whether guides would not take a card at an angle [rad], and it may be mended."""
        config = self.config
        seats = config.seating is not None and self._backings < config.backings
        return seats and abs(yaw) > config.crooked

    def _is_rolled(self, slot: FloatArray) -> bool:
        """Return whether an edge of the card would pass the guides' mouths outside, by its roll."""
        seating, half = self.config.seating, self.config.guide.card_width / 2.0
        right = (inverse(slot) @ self._arm.card_frame(self._wanted))[:3, 0]
        return seating is not None and abs(half * right[2]) > seating.mouth

    def _back_off(self, yaw: float) -> None:
        """Drive back, and then anew to where the card's angle out of the plane [rad] vanishes.

        Which is on the slot's line, but for a robot that rolls, whose arm does not point ahead, or
        that comes to rest beside its place each time.
        """
        self._aside += (self.config.reach - self._arm.mount[1]) * math.sin(yaw)
        self._backing, self._backings, self._tare = True, self._backings + 1, []
        self._enter(InsertionStage.APPROACH)

    @property
    def _pace(self) -> float:
        """Share of the speeds now."""
        followed = self._both_seen or not self.config.watched
        return 1.0 if followed else self.config.following

    def _to_place(self, slot: FloatArray) -> tuple[float, float]:
        """Return how far to the right and ahead the arm's base has to go to its place [m]."""
        ahead = slot[:2, 1] / np.linalg.norm(slot[:2, 1])
        right = np.array([ahead[1], -ahead[0]])
        before = self.config.reach + self.config.stand_off - self._arm.mount[1]
        x, y = slot[:2, 3] + self._aside * right - before * ahead - self._arm.mount[:2]
        return float(x), float(y)

    def _wheels_to(self, aside: float, gap: float) -> FloatArray:
        """Return wheel speeds that lead the arm's base to its place, slower when near.

        It is the base that has to be on the slot's line; the arm makes up for any heading. A robot
        that would come onto the line itself turns there and back, by which it slides downhill.

        Args:
            aside: Distance of the place to the right [m].
            gap: The same ahead [m]; for less than 0 it drives straight back.
        """
        config, lever = self.config, float(self._arm.mount[1])
        speed = min(max(config.slowing * gap, -config.speed), config.speed)
        # It points at its place. Turning uphill it slides by more than that brings, once it is
        # near: it then leaves it.
        slid = float(self._steer.sliding(1.0, self._odometry.tilt)[0])
        brings = gap + lever + math.copysign(slid, aside * slid)
        curve = -aside / (lever * brings) if gap > 0.0 and brings >= lever else 0.0
        # On the spot it would turn about its front axle, and slide aside.
        most = config.turn / config.speed
        return self._steer.wheel_speeds(speed, min(max(curve, -most), most) * speed)

    def _bring(self, slot: FloatArray, pose: FloatArray) -> FloatArray:
        """Move the commanded joints a step towards a pose (3,) of the card; return their rates."""
        config, now = self.config, self._arm.card_frame(self._wanted)
        way = (slot @ planar(pose))[:3, 3] - now[:3, 3]
        period = self._pace * config.period
        most, step = config.card_speed * period, config.card_turn * period
        place = now[:3, 3] + way * min(1.0, most / max(float(np.linalg.norm(way)), 1e-9))
        pitch = pitch_of(now)
        pitch += min(max(self._pitch_at(slot, pose) - pitch, -step), step)
        rates = self._command_card(place, pitch)
        return _STILL if rates is None else rates

    def _pitch_at(self, slot: FloatArray, pose: FloatArray) -> float:
        """Return the pitch of the card at which it has the turn of a pose (3,) in the slot's plane.

        On a robot that rolls by 14 degrees on a rock, 5 degrees of yaw are a degree of turn as
        well: the pitch is chosen by the turn that the card has, not as if it lay in the plane.
        """
        now = self._arm.card_frame(self._wanted)
        return pitch_of(now) + float(pose[2] - to_plane(inverse(slot) @ now)[2])

    def _command_card(self, place: FloatArray, pitch: float) -> FloatArray | None:
        """Set the commanded joints for a position and pitch; return their rates.

        None if it is out of reach; the joints then stay where they are.
        """
        target = self._arm.angles_at(place, pitch, self._wanted)
        rates = (target - self._wanted) / self.config.period
        if not np.all(np.abs(rates) <= _ELBOW):
            return None
        self._wanted = target
        return rates

    def _hand_over(self, slot: FloatArray) -> None:
        """Switch from vision to force; the slot's estimate stays fixed in the world."""
        self._slot = slot
        self._weight = self._arm.weight(self._wanted, self._up)
        start = to_plane(inverse(slot) @ self._arm.card_frame(self._wanted))
        config = self.config
        if config.seating is None:
            self.guide = InsertionGuide(config.guide, start[:3])
        else:
            kind = SeatingGuide if config.forced else StraightSeating
            self.guide = kind(config.guide, start[:3], config.seating, start[3])
        self._enter(InsertionStage.INSERT)

    def _slot_now(self) -> FloatArray:
        """Return (4, 4) from the slot to the robot, which tilts as its arm reaches forward."""
        if self._base is None:
            return self._slot
        change = self._arm.weight(self._wanted, self._up) - self._weight
        return self._base.motion(self._base.tilt(change)).inv().as_matrix() @ self._slot

    def _insert(self, angles: FloatArray) -> Command:
        guide, slot = self.guide, self._slot_now()
        assert guide is not None
        if isinstance(guide, SeatingGuide | StraightSeating):
            pose, beside = guide.step(self.contact), guide.beside
        else:
            pose, beside = guide.step(self.contact[[0, 1, 5]]), 0.0
        place = slot[:3, :3] @ [pose[0], pose[1], beside] + slot[:3, 3]
        rates = self._command_card(place, self._pitch_at(slot, pose))
        if rates is None:
            return self._fail("out of reach", angles)
        if guide.phase is Phase.DONE:
            self._enter(InsertionStage.DONE)
        elif guide.phase is Phase.FAILED:
            return self._fail(guide.reason, angles)
        return self._hold(rates=rates)
