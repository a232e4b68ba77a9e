"""What can be identified of any MuJoCo model: its parameters, by name.

A name is ``ELEMENT.NAME.KIND``, such as ``joint.elbow.damping``. Each parameter has a coordinate of
which a standard normal distribution is what is known beforehand: it is zero as drawn, and one where
the parameter is as far off as may well be.

``delay`` is that of all actuators, to which that of each is added.

A body has ten parameters: what it weighs (``mass``), where its mass lies in its frame
(``centre_x``, ...) and how that is spread about its centre (``stretch_x``, ..., ``shear_yz``, along
the principal axes of its inertia). Each is a deformation of the body's mass as drawn, so that any
values of the ten are those of a physical body, and all physical bodies are among them.
"""

import dataclasses
import difflib
import fnmatch
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal

import mujoco
import numpy as np

from perception.geometry.arrays import FloatArray

RELATIVE = 0.3
"""Spread of what is above zero in the model, as a share of it, unless said otherwise."""
DELAY = 0.02
"""Spread of a delay, unless said otherwise [s]."""
THINNEST = 1e-6
"""Least second moment of a body, over its largest, so that a rod can be stretched too."""
FEW = 60
"""Most parameters that an error lists."""
_AXES = "xyz"

Scale = Literal["factor", "offset", "from zero"]
Writer = Callable[[mujoco.MjSpec, float], None]


class ModelError(ValueError):
    """A model, or a parameter or limit of one, that cannot be used; in one line."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    Attributes:
        name: Such as ``joint.elbow.damping``.
        unit: Unit of its value.
        nominal: Its value as drawn.
        spread: How far off it may well be: a share where the scale is ``factor``, else in `unit`.
        scale: ``factor``: it is above zero, and its coordinate is the logarithm of a factor;
            ``offset``: its coordinate is a difference; ``from zero``: likewise, and never below.
        write: Function that writes a value into a specification in which all inertias are explicit.
    """

    name: str
    unit: str
    nominal: float
    spread: float
    scale: Scale
    write: Writer

    def value(self, coordinate: float) -> float:
        """Return its value at a coordinate."""
        if self.scale == "factor":
            return self.nominal * float(np.exp(self.spread * coordinate))
        return self.nominal + self.spread * coordinate

    def coordinate(self, value: float) -> float:
        """Return the coordinate at which it has a value."""
        if self.scale == "factor":
            return float(np.log(value / self.nominal)) / self.spread
        return (value - self.nominal) / self.spread

    @property
    def lowest(self) -> float:
        """Least coordinate that it may have."""
        return 0.0 if self.scale == "from zero" else -np.inf


def write_all(
    spec: mujoco.MjSpec, parameters: Sequence[Parameter], coordinates: FloatArray
) -> None:
    """Write parameters at their coordinates (n,) into a specification made by `explicit`."""
    for parameter, coordinate in zip(parameters, coordinates.tolist()):
        parameter.write(spec, parameter.value(coordinate))


def explicit(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a copy in which each body's inertia stands by itself, not in its geoms."""
    model, copy = spec.compile(), spec.copy()
    copy.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    copy.compiler.settotalmass = -1.0
    for index, body in enumerate(copy.bodies):
        if model.body_mass[index] > 0.0:
            mass = float(model.body_mass[index])
            turn = _rotation(model.body_iquat[index])
            inertia = turn @ np.diag(model.body_inertia[index]) @ turn.T
            _set_inertial(body, mass, model.body_ipos[index].copy(), _second_moments(inertia))
    return copy


def select(
    spec: mujoco.MjSpec, patterns: Sequence[str], sensors: Mapping[str, int]
) -> list[Parameter]:
    """Return the parameters that patterns name, in the order of the patterns.

    Args:
        spec: The model as drawn, made by `explicit`.
        patterns: Names with ``*`` and ``?``; behind a colon their spread, if another than usual is
            meant: ``joint.*.damping:0.5``. It is a share of what is above zero in the model, and in
            SI units of all else. What is zero in the model has no usual one: it is among those that
            ``*`` names only where one is said.
        sensors: Count of numbers of each sensor in the logs, by name.

    Raises:
        ModelError: Naming what does not fit, and what there is.
    """
    known = {each.name: each for each in catalogue(spec, sensors)}
    chosen: dict[str, Parameter] = {}
    for pattern in patterns:
        name, _, text = pattern.partition(":")
        names = fnmatch.filter(known, name)
        if not names:
            raise ModelError(f"{name}: no such parameter; {_hint(name, list(known))}")
        for each in names:
            spread = _spread(pattern, text) if text else known[each].spread
            if not spread and each != name:
                continue
            if not spread:
                raise ModelError(
                    f"{each} is {known[each].nominal:g} as drawn; say behind a colon how large it "
                    f"may well be [{known[each].unit}]: {each}:0.1"
                )
            chosen[each] = dataclasses.replace(known[each], spread=spread)
    return list(chosen.values())


def _hint(name: str, known: list[str]) -> str:
    """Return what there is, or of many the closest."""
    if len(known) <= FEW:
        return f"there are {', '.join(known)}"
    close = difflib.get_close_matches(name, known, 5, 0.0)
    return f"of {len(known)} the closest are {', '.join(close)}; without --parameters all are shown"


def _spread(pattern: str, text: str) -> float:
    try:
        spread = float(text)
    except ValueError:
        spread = 0.0
    if not 0.0 < spread < np.inf:
        raise ModelError(f"{pattern}: the spread behind the colon is a number above 0")
    return spread


def catalogue(spec: mujoco.MjSpec, sensors: Mapping[str, int]) -> Iterator[Parameter]:
    """Yield all parameters of a model, with their usual spreads; 0 where none is usual.

    Args:
        spec: The model as drawn, made by `explicit`.
        sensors: Count of numbers of each sensor in the logs, by name.
    """
    model = spec.compile()
    for body in spec.bodies[1:]:
        if body.name and model.body(body.name).mass[0] > 0.0:
            yield from _body_parameters(model, body.name)
    for joint in spec.joints:
        if joint.name:
            yield from _joint_parameters(joint)
    for geom in spec.geoms:
        if geom.name and (geom.contype or geom.conaffinity):
            name, friction = geom.name, float(geom.friction[0])
            write = _setter("geom", name, lambda item, value: _put(item.friction, 0, value))
            yield _positive(f"geom.{name}.friction", "1", friction, write)
    if spec.actuators:
        yield Parameter("delay", "s", 0.0, DELAY, "from zero", _keep)
    for actuator in spec.actuators:
        if actuator.name:
            yield from _actuator_parameters(actuator)
            yield Parameter(f"actuator.{actuator.name}.delay", "s", 0.0, DELAY, "from zero", _keep)
    for name, count in sensors.items():
        yield Parameter(f"sensor.{name}.delay", "s", 0.0, DELAY, "from zero", _keep)
        for number in range(count):
            end = f"_{number}" if count > 1 else ""
            yield Parameter(f"sensor.{name}.bias{end}", "SI", 0.0, 0.0, "offset", _keep)
            yield Parameter(f"sensor.{name}.gain{end}", "1", 1.0, 0.05, "factor", _keep)


def _keep(spec: mujoco.MjSpec, value: float) -> None:
    """Write nothing: a delay, a bias or a sensor's gain is not of the model's own."""


def _positive(name: str, unit: str, nominal: float, write: Writer) -> Parameter:
    """Return a parameter that is never below zero; its spread is to be said where it is zero."""
    if nominal > 0.0:
        return Parameter(name, unit, nominal, RELATIVE, "factor", write)
    return Parameter(name, unit, 0.0, 0.0, "from zero", write)


def _setter(element: str, name: str, put: Callable[[Any, float], None]) -> Writer:
    return lambda spec, value: put(getattr(spec, element)(name), value)


def _put(values: Any, index: int, value: float) -> None:
    values[index] = value


def _joint_parameters(joint: Any) -> Iterator[Parameter]:
    slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
    force, inertia = ("N", "kg") if slides else ("N m", "kg m^2")
    angle = "m" if slides else "rad"
    start = f"joint.{joint.name}"
    for kind, unit in (("damping", f"{force} s/{angle}"), ("stiffness", f"{force}/{angle}")):
        # These are the coefficients of a polynomial, of which the first is the linear one.
        nominal = float(getattr(joint, kind)[0])
        write = _setter(
            "joint", joint.name, lambda item, value, kind=kind: _put(getattr(item, kind), 0, value)
        )
        yield _positive(f"{start}.{kind}", unit, nominal, write)
    for kind, attribute, unit in (
        ("friction", "frictionloss", force),
        ("armature", "armature", inertia),
    ):
        write = _setter(
            "joint", joint.name, lambda item, value, name=attribute: setattr(item, name, value)
        )
        yield _positive(f"{start}.{kind}", unit, float(getattr(joint, attribute)), write)


def _actuator_parameters(actuator: Any) -> Iterator[Parameter]:
    """Yield what turns a command into a force; its unit is the model's own."""
    start = f"actuator.{actuator.name}"
    if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
        for kind, index, unit in (("resistance", 0, "ohm"), ("gain", 1, "N m/A")):

            def put_motor(item: Any, value: float, index: int = index) -> None:
                item.gainprm[index] = value

            write = _setter("actuator", actuator.name, put_motor)
            yield _positive(f"{start}.{kind}", unit, float(actuator.gainprm[index]), write)
    elif actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED:
        gain = float(actuator.gainprm[0])
        servo = [index for index in (1, 2) if actuator.biasprm[index] == -gain]

        def put_gain(item: Any, value: float) -> None:
            item.gainprm[0] = value
            for index in servo:  # of a position or a velocity, which acts on the difference
                item.biasprm[index] = -value

        write = _setter("actuator", actuator.name, put_gain)
        yield _positive(f"{start}.gain", "per command", gain, write)
        if actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and 2 not in servo:

            def put_damping(item: Any, value: float) -> None:
                item.biasprm[2] = -value

            write = _setter("actuator", actuator.name, put_damping)
            damping = max(-float(actuator.biasprm[2]), 0.0)
            yield _positive(f"{start}.damping", "per speed", damping, write)


def _body_parameters(model: mujoco.MjModel, name: str) -> Iterator[Parameter]:
    """Yield the ten deformations of a body's mass."""
    body = model.body(name)
    centre, turn = body.ipos.copy(), _rotation(body.iquat)
    moments = _thick(np.diag(_second_moments(np.diag(body.inertia))))
    size = np.sqrt(moments / body.mass[0])
    start = f"body.{name}"

    def deform(spec: mujoco.MjSpec, factor: float, shift: FloatArray, shape: FloatArray) -> None:
        item = spec.body(name)
        inertia = item.fullinertia[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
        within = turn.T @ _second_moments(inertia) @ turn
        within[np.diag_indices(3)] = _thick(np.diag(within))
        _set_inertial(
            item,
            factor * float(item.mass),
            item.ipos + shift,
            factor * turn @ shape @ within @ shape.T @ turn.T,
        )

    still, same = np.zeros(3), np.eye(3)
    mass = float(body.mass[0])
    yield _positive(
        f"{start}.mass", "kg", mass, lambda spec, value: deform(spec, value / mass, still, same)
    )
    for axis, label in enumerate(_AXES):
        unit = np.eye(3)[axis]
        yield Parameter(
            f"{start}.centre_{label}",
            "m",
            float(centre[axis]),
            RELATIVE * float(np.linalg.norm(size)),
            "offset",
            lambda spec, value, unit=unit, at=float(centre[axis]): deform(
                spec, 1.0, (value - at) * unit, same
            ),
        )
    for axis, label in enumerate(_AXES):
        unit = np.diag(np.eye(3)[axis])
        yield Parameter(
            f"{start}.stretch_{label}",
            "1",
            1.0,
            RELATIVE,
            "factor",
            lambda spec, value, unit=unit: deform(spec, 1.0, still, same + (value - 1.0) * unit),
        )
    for first, second in ((0, 1), (0, 2), (1, 2)):
        unit = np.zeros((3, 3))
        unit[first, second] = size[first] / size[second]
        yield Parameter(
            f"{start}.shear_{_AXES[first]}{_AXES[second]}",
            "1",
            0.0,
            RELATIVE,
            "offset",
            lambda spec, value, unit=unit: deform(spec, 1.0, still, same + value * unit),
        )


def _thick(moments: FloatArray) -> FloatArray:
    return np.maximum(moments, THINNEST * moments.max())


def _second_moments(inertia: FloatArray) -> FloatArray:
    """Return the second moments of mass (3, 3) of a body's inertia (3, 3) about its centre."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def _set_inertial(body: Any, mass: float, centre: FloatArray, moments: FloatArray) -> None:
    inertia = np.trace(moments) * np.eye(3) - moments
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat = mass, centre, [1.0, 0.0, 0.0, 0.0]
    body.inertia = np.zeros(3)  # MuJoCo takes one or the other.
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _rotation(quaternion: FloatArray) -> FloatArray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.ascontiguousarray(quaternion))
    return matrix.reshape(3, 3)
