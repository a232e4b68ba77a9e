"""Parameters of models, against what MuJoCo compiles and against clouds of points."""

import fnmatch

import mujoco
import numpy as np
import pytest

from tests.experiments.own.hidden import SWINGS, robot
from twin.prediction.parameters import ModelError, catalogue, explicit, select, write_all

MODEL = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="1 1 1" friction="0.6"/>
  <body name="link" pos="0 0 1">
    <joint name="hinge" damping="0.1" stiffness="2" frictionloss="0.3" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 .3 .1 0" size="0.02" mass="1"/>
    <geom type="box" size=".1 .05 .02" pos=".1 .3 0" mass="0.5"/>
  </body>
  <body name="sled"><joint name="slide" type="slide"/><geom name="block" size="0.1"/></body>
</worldbody><actuator>
  <position name="servo" joint="hinge" kp="10" kv="1"/>
  <velocity name="spin" joint="hinge" kv="2"/>
  <motor name="push" joint="slide"/>
  <dcmotor name="motor" joint="slide" motorconst="0.05" resistance="2"/>
</actuator></mujoco>"""
COMPILED = {
    "joint.hinge.damping": lambda m: m.dof_damping[0],
    "joint.hinge.stiffness": lambda m: m.jnt_stiffness[0],
    "joint.hinge.friction": lambda m: m.dof_frictionloss[0],
    "joint.hinge.armature": lambda m: m.dof_armature[0],
    "geom.floor.friction": lambda m: m.geom("floor").friction[0],
    "actuator.servo.gain": lambda m: m.actuator("servo").gainprm[0],
    "actuator.servo.damping": lambda m: -m.actuator("servo").biasprm[2],
    "actuator.spin.gain": lambda m: m.actuator("spin").gainprm[0],
    "actuator.push.gain": lambda m: m.actuator("push").gainprm[0],
    "actuator.motor.resistance": lambda m: m.actuator("motor").gainprm[0],
    "actuator.motor.gain": lambda m: m.actuator("motor").gainprm[1],
    "body.link.mass": lambda m: m.body("link").mass[0],
    "body.link.centre_y": lambda m: m.body("link").ipos[1],
}


def drawn():
    return explicit(mujoco.MjSpec.from_string(MODEL))


def written(name, coordinate):
    spec = drawn()
    (parameter,) = select(spec, [name], {})
    write_all(spec, [parameter], np.array([coordinate]))
    return parameter, spec.compile()


@pytest.mark.parametrize("name", COMPILED)
def test_parameter_is_read_and_written_where_mujoco_has_it(name):
    parameter, model = written(name, 0.0)
    assert COMPILED[name](model) == pytest.approx(parameter.nominal, rel=1e-12)
    parameter, model = written(name, -0.7)
    assert parameter.value(-0.7) != pytest.approx(parameter.nominal, rel=1e-3)
    assert COMPILED[name](model) == pytest.approx(parameter.value(-0.7), rel=1e-12)


def test_gain_of_a_servo_acts_on_the_difference():
    parameter, model = written("actuator.servo.gain", 1.0)
    assert model.actuator("servo").biasprm[1] == -parameter.value(1.0)
    assert model.actuator("servo").biasprm[2] == -1.0
    parameter, model = written("actuator.spin.gain", 1.0)
    assert model.actuator("spin").biasprm[2] == -parameter.value(1.0)


@pytest.mark.parametrize("name", SWINGS)
def test_explicit_model_is_the_same(name):
    spec = mujoco.MjSpec.from_file(robot(name))
    before, after = spec.compile(), explicit(spec).compile()
    for each in ("body_mass", "body_ipos", "dof_M0", "dof_invweight0"):
        np.testing.assert_allclose(getattr(after, each), getattr(before, each), rtol=1e-9)


def cloud(body):
    """Six points of mass at each axis of a body's inertia that have its second moments."""
    moments = 0.5 * body.inertia.sum() - body.inertia
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3) * np.sqrt(3.0 * moments / body.mass[0])
    points = np.concatenate([axes.T, -axes.T]) + body.ipos
    return points, np.full(6, body.mass[0] / 6.0), turn.reshape(3, 3)


def inertia(points, masses):
    centre = masses @ points / masses.sum()
    off = points - centre
    square = np.einsum("k,ki,kj->ij", masses, off, off)
    return centre, np.trace(square) * np.eye(3) - square


def test_body_deforms_as_a_cloud_of_points_does():
    names = ["mass", "centre_x", "centre_z", "stretch_x", "stretch_z", "shear_xy", "shear_yz"]
    generator = np.random.default_rng(4)
    points, masses, turn = cloud(drawn().compile().body("link"))
    spec = drawn()
    for name in names:  # one after another, each on what the ones before left
        (parameter,) = select(drawn(), [f"body.link.{name}"], {})
        value = parameter.value(generator.normal())
        parameter.write(spec, value)
        kind, _, axis = name.partition("_")
        centre = masses @ points / masses.sum()
        local = (points - centre) @ turn
        if kind == "mass":
            masses = masses * value / parameter.nominal
        elif kind == "centre":
            centre = centre + (value - parameter.nominal) * np.eye(3)["xyz".index(axis)]
        elif kind == "stretch":
            local[:, "xyz".index(axis)] *= value
        else:
            first, second = ("xyz".index(each) for each in axis)
            body = drawn().compile().body("link")
            moments = 0.5 * body.inertia.sum() - body.inertia
            local[:, first] += value * np.sqrt(moments[first] / moments[second]) * local[:, second]
        points = centre + local @ turn.T
    body = spec.compile().body("link")
    centre, tensor = inertia(points, masses)
    np.testing.assert_allclose(body.mass[0], masses.sum(), rtol=1e-9)
    np.testing.assert_allclose(body.ipos, centre, atol=1e-9)
    np.testing.assert_allclose(np.sort(body.inertia), np.linalg.eigvalsh(tensor), rtol=1e-7)


def test_any_coordinates_are_those_of_a_physical_body():
    generator = np.random.default_rng(5)
    parameters = select(drawn(), ["body.link.*"], {})
    assert len(parameters) == 10
    for _ in range(50):
        spec = drawn()
        write_all(spec, parameters, 2.0 * generator.standard_normal(10))
        inertias = spec.compile().body("link").inertia  # MuJoCo refuses what is not physical
        assert np.sort(inertias)[2] <= np.sort(inertias)[:2].sum() * (1.0 + 1e-9)


def test_pattern_takes_what_has_a_usual_spread_and_the_one_that_is_said():
    names = [each.name for each in catalogue(drawn(), {"imu": 2})]
    assert {"delay", "actuator.push.delay", "sensor.imu.bias_1"} <= set(names)
    chosen = select(drawn(), ["joint.*"], {})
    assert [each.name for each in chosen] == fnmatch.filter(names, "joint.hinge.*")
    (slide,) = select(drawn(), ["joint.slide.damping:0.4"], {})
    assert (slide.nominal, slide.spread, slide.lowest) == (0.0, 0.4, 0.0)
    (hinge,) = select(drawn(), ["joint.hinge.damping:0.4"], {})
    assert hinge.value(1.0) == pytest.approx(0.1 * np.exp(0.4))


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("joint.elbow.damping", "joint.elbow.damping: no such parameter; there are body.link.mass"),
        ("joint.slide.damping", r"is 0 as drawn; say .* \[N s/m\]: joint.slide.damping:0.1"),
        ("joint.hinge.damping:-1", "the spread behind the colon is a number above 0"),
        ("joint.hinge.damping:wide", "the spread behind the colon is a number above 0"),
    ],
)
def test_bad_parameter_is_refused_in_one_line(pattern, message):
    with pytest.raises(ModelError, match=message) as caught:
        select(drawn(), [pattern], {})
    assert "\n" not in str(caught.value)


def test_of_many_parameters_an_error_names_the_closest():
    with pytest.raises(ModelError, match="joint.hinge.dampin: no such parameter") as caught:
        select(drawn(), ["joint.hinge.dampin"], {"skin": 40})
    text = str(caught.value)
    assert "joint.hinge.damping" in text and len(text) < 300 and "\n" not in text


def test_inertia_that_the_model_states_stays_as_it_is():
    """Along axes of its own, as URDF and most published models say it."""
    text = """<mujoco><worldbody><body name="a"><joint name="hinge" axis="0 1 0"/>
      <inertial pos="0 0.1 0" quat="0.8 0.6 0 0" mass="2" diaginertia="0.1 0.2 0.15"/>
    </body></worldbody></mujoco>"""
    spec = mujoco.MjSpec.from_string(text)
    inertias = []
    for model in (spec.compile(), explicit(spec).compile()):
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.body("a").iquat)
        axes = turn.reshape(3, 3)
        inertias.append(axes @ np.diag(model.body("a").inertia) @ axes.T)
    np.testing.assert_allclose(inertias[1], inertias[0], atol=1e-12)
    assert not np.allclose(inertias[0], np.diag(np.diag(inertias[0])), atol=1e-3)
