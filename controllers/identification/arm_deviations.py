"""What an arm's drawing and its sensors' calibrations leave unknown, as columns of its wrench.

Each unknown is a number whose deviation is one: a body's mass, a coordinate of its centre or of a
joint's place, an encoder's zero, the play of a gear, the tilt, the wrench sensor's zero, drift,
scale and cross-talk. To first order the measured wrench moves along one column for each. An
estimate that solves for them beside what it seeks, each with its deviation as prior, states a
covariance with all of them in, and learns those that the motion shows.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy.ndimage import convolve1d
from scipy.spatial.transform import RigidTransform

from controllers.identification.arm_sensing import ArmRecord, raised_cosine
from controllers.kinematics.rigid_motion import (
    INERTIA_ELEMENTS,
    FrameMotion,
    inertial_parameters,
)
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from twin.description import RigidBody


@dataclasses.dataclass(frozen=True)
class ArmDeviations:
    """Standard deviations of what is unknown of an arm and its sensors.

    Attributes:
        mass: Of each body's mass, whose inertia goes with it, as a share.
        centre: Of each coordinate of a body's centre of gravity [m].
        length: Of each coordinate of a joint's place in its parent's frame [m].
        encoder: Of a joint's zero [rad].
        play: Of half the play of a joint's gear, about `usual_play` [rad].
        usual_play: Usual half of that play [rad].
        tilt: Of pitch and of roll, as the inclinometer reads them [rad].
        zero: (6,) of the wrench sensor's zero [N, N m].
        drift: (6,) of the change of that zero until the sensor is warm [N, N m].
        warm_up: Time constant of that change [s].
        matrix: (6, 6) of the wrench sensor's scales, on the diagonal, and of how much of each
            component (column) shows in another (row), [unit over unit].
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


def leant(record: ArmRecord, arm: SerialChain, usual_play: float) -> ArmRecord:
    """Return a record with the links' angles, which the play of usual gears parts from encoders'.

    Args:
        record: Motion of arm and base, as measured.
        arm: The arm as drawn, with its payload.
        usual_play: Half of the play [rad].
    """
    angles = record.angles + usual_play * leaning(record, arm)
    return dataclasses.replace(record, angles=angles)


def deviation_columns(
    record: ArmRecord, arm: SerialChain, payload: FloatArray, deviations: ArmDeviations
) -> FloatArray:
    """Return (n, 6, k) by how much one deviation of each unknown moves the measured wrench.

    Args:
        record: Motion of arm and base.
        arm: The empty arm as drawn.
        payload: (10,) inertial parameters of its payload as estimated so far, which deviates by
            nothing.
        deviations: Standard deviations of the unknowns.
    """
    whole = loaded(arm, payload)
    level, lean = _wrench(record, whole), leaning(record, whole)
    columns = [_wrench(record, loaded(other, payload)) - level for other in _arms(arm, deviations)]
    for joint in np.eye(len(arm)):
        for shift in (deviations.encoder * joint, deviations.play * joint * lean):
            turned = dataclasses.replace(record, angles=record.angles + shift)
            columns.append(_wrench(turned, whole) - level)
    for axis in np.eye(3)[:2]:
        # A base that pitches and rolls by more than it shows feels gravity turned the other way.
        base = record.base
        turned = base.specific_force - deviations.tilt * np.cross(axis, base.specific_force)
        tilted = FrameMotion(turned, base.angular_velocity, base.angular_acceleration)
        columns.append(_wrench(dataclasses.replace(record, base=tilted), whole) - level)
    ramp = -np.expm1(-record.times / deviations.warm_up)
    for row, unit in enumerate(np.eye(6)):
        columns.append(np.tile(deviations.zero[row] * unit, (len(level), 1)))
        columns.append(deviations.drift[row] * ramp[:, None] * unit)
        sizes = deviations.matrix[row]
        columns += [(size * load)[:, None] * unit for size, load in zip(sizes, level.T)]
    return np.stack(columns, axis=-1)


def _wrench(record: ArmRecord, arm: SerialChain) -> FloatArray:
    """Return (n, 6) the wrench on an arm that moves so [N, N m]."""
    motion = record.angles, record.rates, record.accelerations, record.base
    return arm.inverse_dynamics(*motion)[1]


def _arms(arm: SerialChain, deviations: ArmDeviations) -> Iterator[SerialChain]:
    """Yield arms that differ from the drawn one by one deviation of one number."""
    for base in _bodies(arm.base, deviations):
        yield dataclasses.replace(arm, base=base)
    for index, joint in enumerate(arm.joints):
        place = joint.transform_link_to_parent
        moved = [
            RigidTransform.from_components(place.translation + shift, place.rotation)
            for shift in deviations.length * np.eye(3)
        ]
        changed = [dataclasses.replace(joint, body=b) for b in _bodies(joint.body, deviations)]
        changed += [dataclasses.replace(joint, transform_link_to_parent=m) for m in moved]
        for other in changed:
            joints = (*arm.joints[:index], other, *arm.joints[index + 1 :])
            yield dataclasses.replace(arm, joints=joints)


def _bodies(body: RigidBody, deviations: ArmDeviations) -> Iterator[RigidBody]:
    heavier = 1.0 + deviations.mass
    yield RigidBody(heavier * body.mass, body.centre, heavier * body.inertia)
    for shift in deviations.centre * np.eye(3):
        yield RigidBody(body.mass, body.centre + shift, body.inertia)
