"""What an arm's drawing and its sensors' calibrations leave unknown, as columns of its wrench.

Each unknown is a number whose deviation is one: a body's mass, a coordinate of its centre or of a
joint's place, an encoder's zero, the play of a gear, the tilt, the wrench sensor's zero, drift,
scale and cross-talk. To first order the measured wrench moves along one column for each. An
estimate that solves for them beside what it seeks, each with its deviation as prior, states a
covariance with all of them in, and learns those that the motion shows.
"""

import dataclasses

import numpy as np
from scipy.ndimage import convolve1d
from scipy.spatial.transform import RigidTransform

from controllers.identification.arm_sensing import ArmRecord, raised_cosine, weighed
from controllers.kinematics.rigid_motion import INERTIA_ELEMENTS, inertial_parameters
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from twin.description import JointDescription, RigidBody


@dataclasses.dataclass(frozen=True)
class ArmDeviations:
    """Standard deviations of what is unknown of an arm and its sensors.

    Attributes:
        mass: Deviation of each body's mass, as a share of it; its inertia goes with it.
        centre: Deviation of a body's centre of gravity along each axis [m].
        length: Deviation of a joint's place in its parent's frame along each axis [m].
        encoder: Deviation of a joint encoder's zero [rad].
        play: Deviation of half the play of a joint's gear from `usual_play` [rad].
        usual_play: Mean of half the play of a joint's gear [rad].
        tilt: Deviation of the inclinometer's zero, of pitch and of roll [rad].
        zero: (6,) deviations of the wrench sensor's zero [N, N m].
        drift: (6,) deviations of the wrench sensor's drift until it is warm [N, N m].
        warm_up: Time constant of the wrench sensor's drift [s].
        matrix: (6, 6) deviations of the wrench sensor's scales, on the diagonal, and of the share
            of each component (column) that shows in another (row), in their units.
    """

    mass: float
    centre: float
    length: float
    encoder: float
    play: float
    usual_play: float
    tilt: float
    zero: FloatArray
    drift: FloatArray
    warm_up: float
    matrix: FloatArray


_SENSOR = (6, 8)
"""Unknowns of the wrench sensor: each component's zero, drift, and shares of all six."""
_SENSOR_COUNT = 6 * 8
_LEANING = 0.02
"""Torque at which a gear leans to one side of its play for the greater part [N m]: around zero, how
far is chance."""
_SMOOTHED = 31  # Ticks: accelerations from encoders are noise in a single one.


def loaded(arm: SerialChain, payload: FloatArray) -> SerialChain:
    """Return an arm whose last link holds a payload.

    Args:
        arm: The empty arm.
        payload: (10,) inertial parameters in the last link's frame, of a body that need not exist.
    """
    last = arm.joints[-1]
    mass, *rest = inertial_parameters(last.body) + payload
    centre = np.array(rest[:3]) / mass
    inertia = np.zeros((3, 3))
    for value, (row, column) in zip(rest[3:], INERTIA_ELEMENTS, strict=True):
        inertia[row, column] = inertia[column, row] = value
    inertia -= mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    held = dataclasses.replace(last, body=RigidBody(float(mass), centre, inertia))
    return dataclasses.replace(arm, joints=(*arm.joints[:-1], held))


def leaning(record: ArmRecord, arm: SerialChain) -> FloatArray:
    """Return (n, joints) where the links lean in the play of their gears, from -1 to 1.

    An encoder is on the motor's side of the play; the link leans to where its load pushes it.

    Args:
        record: Motion of arm and base.
        arm: The arm as drawn, with its payload.
    """
    motion = record.angles, record.rates, record.accelerations, record.base
    torques = arm.inverse_dynamics(*motion)[0] - arm.rotor_inertia * record.accelerations
    smooth = convolve1d(torques, raised_cosine(_SMOOTHED), axis=0, mode="nearest")
    return -np.tanh(smooth / _LEANING)


@dataclasses.dataclass(frozen=True)
class ArmAsMade:
    """An arm and its sensors that are off by some numbers of deviations.

    Attributes:
        arm: The empty arm as drawn.
        deviations: Standard deviations of the unknowns.
        unknowns: (k,) by how many deviations each unknown is off, in the order of
            `deviation_columns`: of the flange and then of each link its body's mass, its centre's
            three coordinates and, of a link, its joint's place; of each joint its zero and its
            play; pitch and roll; of each component of the wrench its zero, drift, and shares of
            all six.
    """

    arm: SerialChain
    deviations: ArmDeviations
    unknowns: FloatArray

    @classmethod
    def drawn(cls, arm: SerialChain, deviations: ArmDeviations) -> "ArmAsMade":
        """Return an arm that is its drawing."""
        return cls(arm, deviations, np.zeros(_SENSOR_COUNT + 2 + 9 * len(arm) + 4))

    @property
    def bodies(self) -> SerialChain:
        """Arm as made."""
        of = self.deviations
        flange, links = self.unknowns[:4], self.unknowns[4 : 4 + 7 * len(self.arm)]
        joints: list[JointDescription] = []
        for joint, own in zip(self.arm.joints, links.reshape(-1, 7), strict=True):
            place = joint.transform_link_to_parent
            moved = RigidTransform.from_components(
                place.translation + of.length * own[4:], place.rotation
            )
            body = _body(joint.body, own[:4], of)
            joints.append(dataclasses.replace(joint, body=body, transform_link_to_parent=moved))
        base = _body(self.arm.base, flange, of)
        return dataclasses.replace(self.arm, base=base, joints=tuple(joints))

    def motion(self, record: ArmRecord, payload: FloatArray | None = None) -> ArmRecord:
        """Return the motion of links and base, of which encoders and inclinometer say a little.

        Args:
            record: Motion as measured.
            payload: (10,) inertial parameters of the payload; None for none.
        """
        of, count = self.deviations, len(self.arm)
        first = 4 + 7 * count
        zeros, plays = self.unknowns[first : first + 2 * count].reshape(-1, 2).T
        whole = self.arm if payload is None else loaded(self.arm, payload)
        play = of.usual_play + of.play * plays
        angles = record.angles + of.encoder * zeros + play * leaning(record, whole)
        # A base that pitches and rolls by more than it shows feels gravity turned the other way.
        pitch, roll = of.tilt * self.unknowns[first + 2 * count : first + 2 * count + 2]
        felt = record.base.specific_force
        base = dataclasses.replace(
            record.base, specific_force=felt - np.cross([pitch, roll, 0.0], felt)
        )
        return dataclasses.replace(record, angles=angles, base=base)

    def sensed(self, wrench: FloatArray, times: FloatArray) -> FloatArray:
        """Return what the sensor shows of true wrenches (n, 6) at some times (n,)."""
        shares, offsets = self._sensor(times)
        return wrench @ shares.T + offsets

    def felt(self, record: ArmRecord) -> FloatArray:
        """Return the true wrenches (n, 6) behind those that the sensor showed."""
        shares, offsets = self._sensor(record.times)
        return np.asarray((record.wrench - offsets) @ np.linalg.inv(shares).T, dtype=float)

    def _sensor(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (6, 6) shares of the components, and (n, 6) offsets at some times."""
        of, own = self.deviations, self.unknowns[-_SENSOR_COUNT:].reshape(_SENSOR)
        ramp = -np.expm1(-times / of.warm_up)
        offsets = of.zero * own[:, 0] + ramp[:, None] * (of.drift * own[:, 1])
        return np.eye(6) + of.matrix * own[:, 2:], offsets


def deviation_columns(
    record: ArmRecord, arm: SerialChain, payload: FloatArray, deviations: ArmDeviations
) -> FloatArray:
    """Return (n, 6, k) by how much one deviation of each unknown moves the measured wrench.

    Args:
        record: Motion of arm and base, as measured.
        arm: The empty arm as drawn.
        payload: (10,) inertial parameters of its payload as estimated so far, which deviates by
            nothing.
        deviations: Standard deviations of the unknowns.
    """
    drawn = ArmAsMade.drawn(arm, deviations)
    moved = drawn.motion(record, payload)
    level, bodies = _wrench(moved, loaded(arm, payload)), 4 + 7 * len(arm)
    columns: list[FloatArray] = []
    for index, unit in enumerate(np.eye(len(drawn.unknowns))):
        made = dataclasses.replace(drawn, unknowns=unit)
        wrench = level
        if index < bodies:
            wrench = _wrench(moved, loaded(made.bodies, payload))
        elif index < len(unit) - _SENSOR_COUNT:
            wrench = _wrench(made.motion(record, payload), loaded(arm, payload))
        columns.append(made.sensed(wrench, record.times) - level)
    return np.stack(columns, axis=-1)


def calibrate(record: ArmRecord, window: int, noise: FloatArray, drawn: ArmAsMade) -> ArmAsMade:
    """Return the likeliest arm and sensors behind a swing without a payload, on a base that rests.

    Args:
        record: Motion of arm and base, and wrench, as measured.
        window: Ticks under the filter of both sides.
        noise: (6,) standard deviation of a wrench sample [N, N m].
        drawn: Arm that is its drawing, and its deviations.
    """
    nothing = np.zeros(10)
    columns = weighed(
        deviation_columns(record, drawn.arm, nothing, drawn.deviations), window, noise
    )
    explained = _wrench(drawn.motion(record), drawn.arm)
    right = weighed((record.wrench - explained)[..., None], window, noise)[:, 0]
    unknowns, excess = np.zeros(columns.shape[1]), 1.0
    for _ in range(3):
        # Errors beyond the noise are in the equations; the unknowns keep their deviations.
        normal = columns.T @ columns + excess * np.eye(columns.shape[1])
        unknowns = np.linalg.solve(normal, columns.T @ right)
        squares = float(np.sum((right - columns @ unknowns) ** 2) + excess * unknowns @ unknowns)
        excess = max(1.0, squares / right.size)
    return dataclasses.replace(drawn, unknowns=unknowns)


def _wrench(record: ArmRecord, arm: SerialChain) -> FloatArray:
    """Return (n, 6) the wrench on an arm that moves so [N, N m]."""
    motion = record.angles, record.rates, record.accelerations, record.base
    return arm.inverse_dynamics(*motion)[1]


def _body(body: RigidBody, unknowns: FloatArray, deviations: ArmDeviations) -> RigidBody:
    """Return a body off by so many deviations of its mass and of its centre's coordinates."""
    heavier = 1.0 + deviations.mass * float(unknowns[0])
    centre = body.centre + deviations.centre * unknowns[1:]
    return RigidBody(heavier * body.mass, centre, heavier * body.inertia)
