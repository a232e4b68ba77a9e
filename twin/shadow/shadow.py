"""A twin beside a robot: what it expects to be measured, tick by tick."""

# mujoco.rollout has no stubs.
# pyright: reportMissingTypeStubs=false

import copy
import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from twin.description import RobotDescription
from twin.prediction.predictor import STATE
from twin.robot import Command, Observation
from twin.servo import SERVO_PERIOD
from twin.shadow.deviations import Deviation, deviating, happened, hasten
from twin.shadow.gain import ShadowNoise, SteadyGain, settle
from twin.shadow.ground import EvenGround
from twin.shadow.readings import Readings

MOST_LOST = 10
"""Ticks between two observations after which the twin still knows where the robot is."""
LOST = 10.0
"""Root mean square of all innovations over their deviations, above which a twin is lost."""
_PATIENCE = 300  # Ticks over which that is averaged.
_CAPPED = 1.2  # How far beyond it innovations count, so that a twin is not lost within a second.
DRIVING = 0.2
"""Wheel speed above which a rover drives [rad/s]."""
SWINGING = 0.05
"""Rate above which a joint of the arm swings [rad/s]."""
MOVING = 10.0
"""Deviations of a rate's noise above which what it is measured of neither sticks nor is blocked."""
STANDING = 0.02
"""Share of its correction by which the ground is corrected below a rover that stands."""
LINGERING = 0.5
"""Time after a drive until a rover stands [s]."""
BEGINNING = 2.0
"""Time in which the twin comes to rest before it begins [s]."""
UNEVEN = 0.02
"""Standard deviation that the ground's slope may have about that [rad]; a detector learns it."""


class Innovation(NamedTuple):
    """What was measured, against what the twin expected.

    Beside the n readings of the channels it has pitch and roll of the ground that was driven over,
    less those of the ground below a rover that drives, as a tilt that drives along is not the
    ground's; on uneven ground they are NaN, and so is the centre angle, which the ground twists.

    Attributes:
        time: Robot time of the observation [s].
        values: (n + 2,) measured less expected; NaN where nothing new was measured.
        sigma: (n + 2,) their standard deviations, if the robot is as the twin.
        sensitivities: (k, n + 2) change of the expected by one unit of each deviation; 0 of what
            happens wholly or not at all.
        driving: Whether the rover drives, or did a moment ago.
        swinging: Whether its arm swings, or did a moment ago.
        refuted: (k,) deviations that cannot be, as the part moves that would stick or be blocked.
        tried: (m, n + 2) measured less what was expected with the deviations of `Shadow.try_out`.
        foreseen: (n,) measured less what was expected when `Shadow.foresee` was called last.
    """

    time: float
    values: FloatArray
    sigma: FloatArray
    sensitivities: FloatArray
    driving: bool
    swinging: bool
    refuted: NDArray[np.bool_]
    tried: FloatArray
    foreseen: FloatArray


@dataclasses.dataclass(frozen=True)
class ShadowConfig:
    """A shadow.

    Attributes:
        noise: What the model does not know.
        threads: Count of threads that share the models; one is the caller's own.
        even: Whether the ground is even, level or not, so that what tilts or twists the rover is
            its own.
    """

    noise: ShadowNoise = ShadowNoise()
    threads: int = 2
    even: bool = True


class Shadow:
    """Runs beside one robot.

    Beside the twin run copies of it, each with one deviation that has a size; all are driven by the
    same commands and corrected by the same gain. So the difference of what two of them expect is
    what that deviation would do to the twin's innovations, friction that sticks or slides included.
    Further copies try out deviations of any size, and what happens wholly or not at all. A last one
    is corrected by nothing: it foresees.

    Args:
        model: The rover as drawn, made by `twin.shadow.deviations.shadow_scene`.
        robot: The rover as drawn.
        deviations: Ways in which the robot may differ.
        config: Noise and threads; None for the default.

    Attributes:
        model: As given; the rover as drawn.
        channels: Where each channel's readings are, by its name.
        noise: (n,) standard deviations of the readings' noise by datasheet, rounding included.
        deviations: (k,) as given.
        known: (k,) the deviations that the twin has.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: RobotDescription,
        deviations: Sequence[Deviation],
        config: ShadowConfig | None = None,
    ) -> None:
        self._config = config or ShadowConfig()
        self.model, self._robot = model, robot
        self.deviations = list(deviations)
        self._readings = Readings(model, robot)
        self.channels, self.noise = self._readings.channels, self._readings.sigma
        self._steps = round(SERVO_PERIOD / model.opt.timestep)
        self._axes = np.array([model.actuator(f"{robot.name}/{name}").id for name in robot.axes])
        threads = self._config.threads
        count = len(self.deviations)
        #: Of the deviations, those that have a size.
        self._sized = np.flatnonzero([not each.encoder for each in self.deviations])
        self._units = np.array([self.deviations[each].step for each in self._sized])
        self._usual = 1 + len(self._sized)
        #: (k, n) readings of the encoder of what sticks or is blocked.
        self._own = np.zeros((count, self._readings.size), dtype=bool)
        for row, each in zip(self._own, self.deviations):
            for channel, number in each.encoder:
                row[self.channels[channel].start + number] = True
        self._sticking = np.array([each.sticks for each in self.deviations], dtype=bool)
        #: Of the rates, and of the deviations that block one: which.
        self._blocking = [
            (i, int(model.joint(each.blocked).dofadr[0]))
            for i, each in enumerate(self.deviations)
            if each.blocked
        ]
        self._pool: Any = Rollout(nthread=threads if threads > 1 else 0)
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        size = mujoco.mj_stateSize(model, STATE)
        self._states: FloatArray = np.eye(size)[4:5]
        #: Slope in pitch and roll, as the world looks, and twist, of each.
        self._grounds: FloatArray = np.zeros((1, 3))
        self._driven_over = EvenGround()
        self._tilts: FloatArray = np.zeros((1, 2))
        self._twisted = False
        self.know(np.zeros(count))
        self.reset()

    def close(self) -> None:
        """End the threads."""
        self._pool.close()

    def know(self, values: FloatArray) -> None:
        """Give the twin deviations (k,), as they were identified; the state stays."""
        self.known = np.array(values, dtype=float)
        rows = np.tile(self.known, (self._usual + 1, 1))
        rows[np.arange(1, self._usual), self._sized] += self._units
        self._run(rows, [self._hasty(row) for row in rows])
        noise = self._config.noise
        if self._config.even:
            noise = dataclasses.replace(noise, twist=0.0)
        self._gain = SteadyGain(self._deviating(self.known), self._readings, noise, self._steps)

    def try_out(self, values: FloatArray, begin: Sequence[int] | None = None) -> None:
        """Let copies run from where the twin is, instead of earlier ones.

        On even ground they begin on that which it drove over.

        Args:
            values: (m, k) deviations of the copies.
            begin: (m,) the earlier copy from where each begins instead; None for the twin.
        """
        usual = self._usual
        rows = np.vstack([self._rows[:usual], values, self._rows[-1:]])
        tried = [self._hasty(row) for row in values]
        from_where = None if begin is None else usual + np.asarray(begin, dtype=np.intp)
        self._run(rows, [*self._models[:usual], *tried, self._models[-1]], from_where)
        if begin is None and self._config.even:
            # What a change did looked like a slope, too.
            self._grounds[usual:-1, :2] = self._driven_over.taken(float(self._headings[0]))
            self._tilt_gravity()

    def foresee(self, values: FloatArray) -> None:
        """Begin to predict from where the twin is, with deviations (k,), as the robot has them."""
        rows = np.vstack([self._rows[:-1], values])
        stay = np.arange(self._usual, len(self._models) - 1)
        self._run(rows, [*self._models[:-1], self._hasty(values)], stay)
        for each in (self._states, self._grounds, self._tilts):
            each[-1] = each[0]
        self._tilt_gravity()

    def _run(
        self,
        rows: FloatArray,
        models: list[mujoco.MjModel],
        begin: NDArray[np.intp] | None = None,
    ) -> None:
        """Run models with deviations (m, k); the states of the usual ones and of the last stay.

        Those between begin where the twin is, or the models of given numbers.
        """
        self._rows, self._models = happened(self.deviations, rows), models
        self._gravities = [model.opt.gravity for model in models]
        self._outer()
        usual = self._usual
        begin = np.zeros(len(rows) - usual - 1, dtype=np.intp) if begin is None else begin
        self._states, self._grounds, self._tilts = (
            np.vstack([each[:usual], each[begin], each[-1:]])
            if len(each) > usual
            else np.tile(each[0], (len(rows), 1))
            for each in (self._states, self._grounds, self._tilts)
        )
        self._tilt_gravity()

    def _deviating(self, values: FloatArray) -> mujoco.MjModel:
        model = copy.copy(self.model)
        deviating(model, self.deviations, values)
        return model

    def _hasty(self, values: FloatArray) -> mujoco.MjModel:
        model = self._deviating(values)
        hasten(model)
        return model

    @property
    def slope(self) -> FloatArray:
        """(2,) of the ground where it stands, in pitch and roll [rad]."""
        return self._as_it_looks(self._grounds[:1, :2])[0]

    def _as_it_looks(self, slopes: FloatArray) -> FloatArray:
        """Return slopes of the first models (m, 2), as the world looks, as each rover looks."""
        right, forward = _turn(-self._headings[: len(slopes)], slopes[:, 1], -slopes[:, 0])
        return np.column_stack([-forward, right])

    @property
    def _headings(self) -> FloatArray:
        """(m,) of the models [rad]."""
        w, x, y, z = self._states[:, 4:8].T
        return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def places(self) -> FloatArray | None:
        """(nq,) places of the twin's degrees of freedom; None before it has begun."""
        if self._before is None:
            return None
        return self._states[0, 1 : 1 + self.model.nq].copy()

    def reset(self) -> None:
        """Begin anew with the next observation."""
        self._before: Observation | None = None
        self._grounds[:, :2] = 0.0

    def step(self, seen: Observation, applied: Command) -> Innovation | None:
        """Predict to an observation, and correct the twin by it.

        Args:
            seen: Observation of the robot.
            applied: What was applied since the one before.

        Returns:
            The innovations; None for the first observation, with which the twin begins, and until
            the arm's angles and the tilt are measured. After a longer gap it begins anew, and where
            it misses all for seconds: someone lifted the robot, or it fell.
        """
        before, self._before = self._before, seen
        ticks = 0 if before is None else round((seen.time - before.time) / SERVO_PERIOD)
        if before is None or not 0 < ticks <= MOST_LOST or self._missed > LOST**2:
            if not self._begin(seen):
                self._before = None
            return None
        self._gain.follow(self._states[0, 1 + self._readings.joints[0]])
        for _ in range(ticks - 1):
            self._predict(applied)
        expected = self._predict(applied)
        measured = self._readings.measured(seen, before)
        expected += self._stuck * (self._held - expected)
        innovations = measured - expected
        if seen.wheel_speeds.usable and np.abs(seen.wheel_speeds.value).max() > DRIVING:
            self._drove = seen.time
        if seen.arm_rates.usable and np.abs(seen.arm_rates.value).max() > SWINGING:
            self._swung = seen.time
        driving = seen.time - self._drove < LINGERING
        self._correct(np.nan_to_num(innovations), driving)
        self._set_back(measured[self.channels["arm_angles"]])
        there = innovations[0, ~np.isnan(measured)] / self._gain.sigma[~np.isnan(measured)]
        square = float(there @ there) / max(1, len(there))
        # A number that is none: it was thrown out of the physics.
        square = min(square, (_CAPPED * LOST) ** 2) if math.isfinite(square) else math.inf
        self._missed += (square - self._missed) / _PATIENCE
        tilted = self._tilted(driving)
        effects = np.hstack([expected, tilted])[: self._usual]
        sensitivities = np.zeros((len(self.deviations), effects.shape[1]))
        sensitivities[self._sized] = (effects[1:] - effects[0]) / self._units[:, None]
        values = np.hstack([innovations, -tilted if driving else np.full_like(tilted, np.nan)])
        if not self._config.even:
            values[:, [self.channels["centre_angle"].start, -2, -1]] = np.nan
        return Innovation(
            seen.time,
            values[0],
            np.append(self._gain.sigma, [UNEVEN, UNEVEN]),
            sensitivities,
            driving,
            seen.time - self._swung < LINGERING,
            self._refuted(measured),
            values[self._usual : -1],
            innovations[-1],
        )

    def _tilted(self, driving: bool) -> FloatArray:
        """Return slopes (m, 2) less that of the ground which was driven over, and learn this."""
        slopes = self._grounds[:, :2]
        if driving:
            self._driven_over.drive(slopes[0], float(self._headings[0]))
        return self._as_it_looks(slopes - self._driven_over.slope)

    def _refuted(self, measured: FloatArray) -> NDArray[np.bool_]:
        """Return which deviations (k,) cannot be: their part is measured (n,) to move."""
        rates = np.zeros(self._readings.size, dtype=bool)
        for channel in ("wheel_speeds", "arm_rates"):
            rates[self.channels[channel]] = True
        moving = rates & (np.abs(np.nan_to_num(measured)) > MOVING * self._readings.sigma)
        return np.asarray((self._own & moving).any(axis=1))

    def _set_back(self, angles: FloatArray) -> None:
        """Set back to the twin the copies whose encoder sticks, where it does not.

        Args:
            angles: Those of the arm as measured (joints,); NaN for none. One that is another than
                before has not stuck; a tachometer's noise tells nothing.
        """
        held = self._held[self.channels["arm_angles"]]
        new = np.isfinite(angles) & (angles != held)
        held[new] = angles[new]
        moved = (self._stuck[:-1, self.channels["arm_angles"]] * new).any(axis=1)
        for each in (self._states, self._grounds, self._tilts):
            each[:-1][moved] = each[0]

    def _outer(self) -> None:
        """Set what is outside of the models.

        These are volts of each axis at full duty (m, axes), what readings are off by (m, n), which
        of them stay (m, n), and the models whose rates are blocked.
        """
        rows, count = self._rows, len(self._rows)
        self._supply = np.tile(self.model.actuator_ctrlrange[self._axes, 1], (count, 1))
        self._bias = np.zeros((count, self._readings.size))
        for column, deviation in zip(rows.T, self.deviations):
            for axis, share in deviation.supply.items():
                left = np.clip(1.0 - share * column, 0.0, None)
                self._supply[:, self._robot.axes.index(axis)] *= left
            for (channel, number), share in deviation.reading.items():
                self._bias[:, self.channels[channel].start + number] += share * column
        self._stuck = np.clip(rows[:, self._sticking] @ self._own[self._sticking], 0.0, 1.0)
        places = [(row, i, freedom) for i, freedom in self._blocking for row in range(count)]
        held = [(row, freedom) for row, i, freedom in places if rows[row, i] > 0.0]
        self._blocked = np.array(held, dtype=np.intp).reshape(-1, 2).T

    def _begin(self, seen: Observation) -> bool:
        """Set the twin to rest where the robot is measured, and return whether it is."""
        self._missed, self._drove, self._swung = 0.0, seen.time, seen.time
        if not (seen.arm_angles.usable and seen.inclinometer.usable):
            return False
        drawn = self.model
        places = drawn.key_qpos[0].copy()
        places[self._readings.joints[0]] = seen.arm_angles.value
        #: What readings are that stick: angles the latest that were new, rates none.
        self._held: FloatArray = np.zeros(self._readings.size)
        self._held[self.channels["arm_angles"]] = seen.arm_angles.value
        data = mujoco.MjData(drawn)
        self._grounds[:, :2] = 0.0
        self._tilt_gravity()
        settle(self._models[0], data, places, self._readings, BEGINNING)
        count = len(self._models)
        state = np.empty(mujoco.mj_stateSize(drawn, STATE))
        mujoco.mj_getState(drawn, data, state, STATE)
        state[0] = 0.0
        self._states = np.tile(state, (count, 1))
        tilt = np.array([2.0 * data.qpos[4], 2.0 * data.qpos[5]])
        self._grounds[:, :2] = np.asarray(seen.inclinometer.value, dtype=float) - tilt
        if seen.centre_angle.usable and not (self._config.even and self._twisted):
            # What is left of it on even ground is how it was made.
            self._twisted = True
            self._grounds[:, 2:] = seen.centre_angle.value - data.qpos[self._readings.centre[:1]]
        self._driven_over.begin(self._grounds[0, :2])
        self._tilts = np.tile(tilt, (count, 1)) + self._grounds[:, :2]
        self._tilt_gravity()
        return True

    def _tilt_gravity(self) -> None:
        """Turn gravity in each model as its slope has it."""
        pitch, roll = np.sin(self._grounds[:, :2]).T
        down = -np.sqrt(np.maximum(1.0 - pitch**2 - roll**2, 0.0))
        for own, pull in zip(self._gravities, GRAVITY * np.column_stack([roll, -pitch, down])):
            own[:] = pull

    def _predict(self, applied: Command) -> FloatArray:
        """Advance all models by a tick, and return what they expect (m, n)."""
        duty = np.concatenate([applied.wheels, applied.arm])
        control = np.zeros((len(self._models), self._steps, self.model.nu))
        control[:, :, self._axes] = (self._supply * duty)[:, None]
        states, sensed = self._pool.rollout(
            self._models, self._data, self._states, control, nstep=self._steps
        )
        self._states = states[:, -1].copy()
        self._states[:, 0] = 0.0
        expected = self._readings.expect(self._states, sensed, self._tilts) + self._bias
        expected[:, self.channels["centre_angle"]] += self._grounds[:, 2:]
        return expected

    def _correct(self, innovations: FloatArray, driving: bool) -> None:
        """Correct all models, and the ground that each believes in, by their innovations (m, n)."""
        freedoms, count = self.model.nv, self.model.nq
        change: FloatArray = innovations @ self._gain.gain.T
        change[-1] = 0.0
        change[:, 2 * freedoms :] *= 1.0 if driving else STANDING
        places = self._states[:, 1 : 1 + count]
        places[:, :3] += change[:, :3]
        places[:, 3:7] = _turned(places[:, 3:7], change[:, 3:6])
        places[:, 7:] += change[:, 6:freedoms]
        # Velocity and slope are the world's, their corrections as each rover looks.
        headings, along = self._headings, change[:, freedoms : freedoms + 2]
        along[:] = np.column_stack(_turn(headings, along[:, 0], along[:, 1]))
        rates = self._states[:, 1 + count :]
        rates += change[:, freedoms : 2 * freedoms]
        rates[self._blocked[0], self._blocked[1]] = 0.0
        pitch, roll, twist = change[:, 2 * freedoms :].T
        right, forward = _turn(headings, roll, -pitch)
        self._grounds += np.column_stack([-forward, right, twist])
        self._tilt_gravity()


def _turned(quaternions: FloatArray, angles: FloatArray) -> FloatArray:
    """Return quaternions (m, 4) turned by small angles (m, 3) about their own axes [rad]."""
    w, v = quaternions[:, :1], quaternions[:, 1:]
    half = 0.5 * angles
    real = w - np.sum(v * half, axis=1, keepdims=True)
    found = np.hstack([real, v + w * half + np.cross(v, half)])
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def _turn(angles: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return coordinates (m,) of vectors that are turned by angles (m,) [rad]."""
    cosine, sine = np.cos(angles), np.sin(angles)
    return cosine * x - sine * y, sine * x + cosine * y
