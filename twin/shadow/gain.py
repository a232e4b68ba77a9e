"""How far a measurement corrects a shadow's state: the steady gain of a Kalman filter.

The model is linearised about rest on level ground in the arm's present posture, looking along the y
axis, without dry friction: what sticks there slides in motion. In another posture this is done in
parts, a part a tick, so that no tick takes long. Its state is a small place and rate
of each degree of freedom, the slope of the ground, and its twist: how much more it rolls below one
half than below the other, which the centre joint follows. Where a rover stands and which way it
looks, nothing tells, and nothing corrects.
"""

import copy
import dataclasses
from collections.abc import Iterator

import mujoco
import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from twin.prediction.predictor import HOLDING, rest
from twin.shadow.readings import Readings

SMALL = 1e-7  # Step of the finite differences [SI].
SETTLING = 0.3  # Time in which the base comes to rest under an arm in another posture [s].
_UNSEEN = (0, 1, 5)  # Degrees of freedom: place on the ground, and heading.
_FIRST, _NEXT = 40, 8  # Steps towards the steady covariance, at first and for each new posture.
_WILD = 1e4  # Change of the state within a tick, over that before it, that is no rover's motion.
_PARTS = 3  # Ticks over which the base comes to rest in a new posture.


@dataclasses.dataclass(frozen=True)
class ShadowNoise:
    """What the model does not know, as standard deviations in each tick.

    Rates change by what ground and gears do beside the model; what a reading's model misses is
    added to its noise by datasheet. Assumptions, larger than what three rovers as made missed on
    level ground.

    Attributes:
        base: Change of the base's velocity [m/s] and turning [rad/s].
        springs: Change of the rates of the wheels' springs [m/s].
        wheels: Change of the wheels' speeds [rad/s].
        joints: Change of the arm's rates [rad/s].
        centre: Change of the centre joint's rate [rad/s].
        slope: Change of the ground's slope below a rover that drives [rad].
        twist: Change of its twist likewise [rad]; 0 where the ground has none.
        readings: What the model of each channel misses, by its name; forces before moments.
            Forces and accelerations are to correct nothing: what a load adds to them for good, the
            state would make up for.
    """

    base: tuple[float, float] = (0.01, 0.03)
    springs: float = 0.01
    wheels: float = 0.15
    joints: float = 0.08
    centre: float = 0.03
    slope: float = 1e-3
    twist: float = 1e-3
    readings: tuple[tuple[str, tuple[float, ...]], ...] = (
        ("wheel_speeds", (0.05,)),
        ("centre_angle", (0.004,)),
        ("arm_angles", (5e-4,)),
        ("arm_rates", (0.03,)),
        ("inclinometer", (0.01,)),
        ("arm_base_wrench", (4.0, 4.0, 4.0, 0.6, 0.6, 0.6)),
        ("accelerometer", (4.0,)),
        ("gyro", (0.02,)),
    )


class SteadyGain:
    """The gain in the arm's posture, calculated anew where that is another one.

    Args:
        model: Model of the shadow; it stays as it is.
        readings: What is read of it.
        noise: What the model does not know.
        steps: Steps of the model in a tick.
        posture: Change of a joint from which on the gain is calculated anew [rad].

    Attributes:
        gain: (2 freedoms + 3, n) correction of places, rates, slope and twist by innovations.
        sigma: (n,) standard deviations of the innovations.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        readings: Readings,
        noise: ShadowNoise,
        steps: int,
        posture: float = 0.2,
    ) -> None:
        self._model, self._readings, self._steps, self._posture = (
            copy.copy(model), readings, steps, posture,
        )  # fmt: skip
        self._model.dof_frictionloss[:] = 0.0
        self._data = mujoco.MjData(self._model)
        freedoms = int(model.nv)
        rates = np.full(freedoms, noise.centre)
        rates[:3], rates[3:6] = noise.base
        rates[readings.springs], rates[readings.wheels] = noise.springs, noise.wheels
        rates[readings.joints[1]] = noise.joints
        ground = [noise.slope, noise.slope, noise.twist]
        self._process = np.diag(np.square(np.concatenate([np.full(freedoms, 1e-5), rates, ground])))
        variances = np.square(readings.sigma)
        for (_, values), place in zip(noise.readings, readings.channels.values()):
            variances[place] += np.square(values)
        self._noise = np.diag(variances)
        # What has no noise is known.
        self._covariance: FloatArray = np.where(self._process > 0.0, 1e-4, 0.0)
        self._at: FloatArray | None = None
        self._parts: Iterator[None] = iter(())

    def follow(self, angles: FloatArray) -> None:
        """Calculate the gain at first, and a part of it while the arm's posture changes.

        Args:
            angles: (joints,) of the arm [rad].
        """
        if self._at is None:
            for _ in self._calculated(angles, 1, _FIRST):
                pass
        for _ in self._parts:
            return
        if self._at is not None and np.abs(angles - self._at).max() >= self._posture:
            self._parts = self._calculated(angles, _PARTS, _NEXT)

    def _calculated(self, angles: FloatArray, parts: int, steps: int) -> Iterator[None]:
        """Calculate the gain in a posture, a part of it for each item.

        Where the arm or a wheel is about to touch or to leave something, a small change makes a
        large one, and the gain stays that of another posture.
        """
        first, self._at = self._at is None, angles.copy()
        places = self._model.key_qpos[0].copy()
        home = places[self._readings.joints[0]]
        places[self._readings.joints[0]] = angles
        yield from settling(self._model, self._data, places, self._readings, SETTLING, parts)
        transition, sensed = self._linearised()
        yield
        if np.abs(transition).max() > _WILD:
            if first:
                yield from self._calculated(home, parts, steps)
            return
        for _ in range(steps):
            self._advance(transition, sensed)
            yield

    def _advance(self, transition: FloatArray, sensed: FloatArray) -> None:
        """Advance the covariance by a tick, which gives the gain of that tick."""
        unseen = list(_UNSEEN)
        before: FloatArray = transition @ self._covariance @ transition.T + self._process
        before[unseen], before[:, unseen] = 0.0, 0.0
        innovation: FloatArray = sensed @ before @ sensed.T + self._noise
        gain = np.linalg.solve(innovation, sensed @ before).T
        self.gain: FloatArray = np.asarray(gain, dtype=float)
        # In Joseph's form, which stays a covariance where a wheel about to lift is linearised.
        kept = np.eye(len(before)) - self.gain @ sensed
        after = kept @ before @ kept.T + self.gain @ self._noise @ self.gain.T
        self._covariance: FloatArray = 0.5 * (after + after.T)
        self.sigma: FloatArray = np.sqrt(np.diag(innovation))

    def _linearised(self) -> tuple[FloatArray, FloatArray]:
        """Return how the state after a tick, and the readings, change with the state."""
        model, data, size = self._model, self._data, 2 * self._model.nv
        one, sensed = np.zeros((size, size)), np.zeros((model.nsensordata, size))
        mujoco.mjd_transitionFD(model, data, SMALL, True, one, None, sensed, None)
        transition = np.eye(size + 3)
        transition[:size, :size] = one
        readings = np.hstack(
            [self._readings.linear(sensed, model.nv), np.zeros((self._readings.size, 3))]
        )
        place = self._readings.channels
        readings[place["inclinometer"], size : size + 2] = np.eye(2)
        readings[place["centre_angle"], -1] = 1.0
        level = self._felt()
        for column, turn in enumerate(([0.0, -1.0, 0.0], [1.0, 0.0, 0.0])):
            pulled, forces = self._felt(GRAVITY * SMALL * np.array(turn))
            change = (pulled - level[0]) / SMALL * model.opt.timestep
            transition[model.nv : size, size + column] = change
            transition[: model.nv, size + column] = change * model.opt.timestep
            felt = (forces - level[1]) / SMALL
            readings[place["arm_base_wrench"], size + column] = felt[self._readings.forces[:6]]
            readings[place["accelerometer"], size + column] = felt[self._readings.forces[6:]]
        return np.linalg.matrix_power(transition, self._steps), readings

    def _felt(self, pull: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return accelerations and sensors' data with another gravity."""
        gravity = self._model.opt.gravity.copy()
        self._model.opt.gravity[:] = gravity + pull
        data = copy.copy(self._data)
        mujoco.mj_forward(self._model, data)
        self._model.opt.gravity[:] = gravity
        return data.qacc.copy(), data.sensordata.copy()


def settle(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    places: FloatArray,
    readings: Readings,
    seconds: float = SETTLING,
) -> None:
    """Let a rover come to rest with its arm held where it is.

    Args:
        model: The model.
        data: Receives the state at rest.
        places: (nq,) where it begins.
        readings: Tells the arm's joints.
        seconds: Time that it takes [s].
    """
    for _ in settling(model, data, places, readings, seconds, 1):
        pass


def settling(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    places: FloatArray,
    readings: Readings,
    seconds: float,
    parts: int,
) -> Iterator[None]:
    """Yield after each part of what `settle` does; the model is as it was in between."""
    rest(model, data, places, np.zeros(int(model.nu)))
    own = model.dof_armature.copy()
    for _ in range(parts):
        model.dof_armature[readings.joints[1]] = HOLDING
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep / parts))
        model.dof_armature[:] = own
        yield
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
