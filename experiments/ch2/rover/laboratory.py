"""The rover's true dynamic parameters, measured on the model as in a laboratory.

Thesis section 2.6.2: stiffness by deflection under load, damping by the impulse response fitted to
a second-order equation, inertia by that response and by a pendulum. All without the arm, whose
share the force/torque sensor measures.

A robot as made has four different springs and masses off its middle, so its pitch is coupled with
roll and heave, a little. What is measured then is what a laboratory would: the pitch that a
pitching moment or a force in the robot's plane of symmetry gives at rest, and the frequency and
decay of the one oscillation that fits the released pitch best. Five numbers describe no coupled
robot fully; these are the ones nearest to it as pitch alone shows it. So it is with roll, of which
the mean of the front and the rear half counts: the centre joint lets them roll apart.
"""

import functools

import mujoco
import numpy as np
import scipy.optimize

from controllers.identification.swing_plane import PITCH, ROLL, SwingPlane
from models.as_made import alter_rover
from models.compose import LABORATORY, WHEELS, RobotPlacement, load_part, make_model, settle
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

LOAD = 1.0  # [N] or [N m]: tilts the rover by less than 0.2 degrees
_STEP = 0.00025  # [s]: at 1 ms the inertia would read 1 % too high


class _Bench:
    """The bare rover at rest on the floor of the laboratory."""

    def __init__(self, robot: RobotPlacement, plane: SwingPlane) -> None:
        bare = RobotPlacement(robot.name, arm=False, made=robot.made)
        self.model = make_model(LABORATORY, [bare])
        self.model.opt.timestep = _STEP
        self.rest = settle(self.model, 2.0)
        names = (f"{robot.name}/chassis", f"{robot.name}/rear_chassis")
        self.body, *_ = self.halves = [self.model.body(name).id for name in names]
        self.along, self.axis = plane.along, plane.axis
        self.mount = self.rest.site(f"{robot.name}/attachment_site").xpos.copy()
        # MuJoCo's dry friction creeps: a robot as made, which does not weigh alike on its wheels,
        # rolls by micrometres meanwhile. So what is compared has waited as long.
        self.unloaded = self.tilt(self.loaded(np.zeros(3), np.zeros(3)))

    def tilt(self, data: mujoco.MjData) -> float:
        """Return the tilt [rad]: the elevation of the plane's y axis, mean of the halves."""
        up = data.xmat[self.halves].reshape(-1, 3, 3)[:, 2]
        return float(np.mean(np.arcsin(up @ self.along)))

    def loaded(self, force: FloatArray, torque: FloatArray, seconds: float = 1.5) -> mujoco.MjData:
        """Return the rover at rest under a load at the arm's mount."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.rest.qpos
        for _ in range(round(seconds / _STEP)):
            data.qfrc_applied[:] = 0
            mujoco.mj_applyFT(
                self.model, data, force, torque, self.mount, self.body, data.qfrc_applied
            )
            mujoco.mj_step(self.model, data)
        return data

    def deflection(self, along: float = 0.0, up: float = 0.0, torque: float = 0.0) -> float:
        """Return the change of tilt under a load [rad]."""
        data = self.loaded(along * self.along + [0.0, 0.0, up], torque * self.axis)
        return self.tilt(data) - self.unloaded

    def released(self, seconds: float = 0.6) -> tuple[FloatArray, FloatArray]:
        """Return times and tilt after a tilting moment is let go."""
        data = self.loaded(np.zeros(3), LOAD * self.axis)
        data.qfrc_applied[:] = 0
        tilts = []
        for _ in range(round(seconds / _STEP)):
            mujoco.mj_step(self.model, data)
            tilts.append(self.tilt(data) - self.unloaded)
        times = _STEP * np.arange(1.0, len(tilts) + 1)
        return times.astype(np.float64), np.array(tilts)


@functools.lru_cache
def laboratory_values(
    robot: RobotPlacement = RobotPlacement(),  # noqa: B008
    plane: SwingPlane = PITCH,
) -> dict[str, float]:
    """Return Table 2-2's parameters of a simulated rover, by name, SI units; or those of its roll.

    Also "rz_to_centre", the thesis' lever from the centre of gravity, and the inertia about the
    ground line from the pendulum, such as "ixx_pendulum".

    Args:
        robot: Robot, whose arm is taken off; `RobotPlacement.made` says how it was made.
        plane: Plane in which it tilts.
    """
    bench = _Bench(robot, plane)
    stiffness = LOAD / bench.deflection(torque=LOAD)
    times, tilts = bench.released()
    decay, frequency = _second_order(times, tilts)
    inertia = stiffness / (decay**2 + frequency**2)
    centre = bench.rest.subtree_com[bench.body]
    values = (
        inertia,
        bench.deflection(up=LOAD) * stiffness / LOAD,
        -bench.deflection(along=LOAD) * stiffness / LOAD,
        2 * decay * inertia,
        stiffness,
    )
    return {
        **dict(zip(plane.parameters, values, strict=True)),
        "rz_to_centre": float(bench.mount[2] - centre[2]),
        f"{plane.parameters[0]}_pendulum": _pendulum_inertia(robot, float(centre[2]), plane),
    }


def laboratory_roll(robot: RobotPlacement) -> dict[str, float]:
    """Return the parameters of a simulated rover's roll, by name, SI units.

    Args:
        robot: Robot, whose arm is taken off.
    """
    return laboratory_values(robot, ROLL)


def _second_order(times: FloatArray, tilts: FloatArray) -> tuple[float, float]:
    """Fit a decaying oscillation; return its decay [1/s] and damped frequency [rad/s]."""

    def residuals(x: FloatArray) -> FloatArray:
        wave = x[2] * np.cos(x[1] * times) + x[3] * np.sin(x[1] * times)
        return (np.exp(-x[0] * times) * wave - tilts) / tilts[0]

    start = np.array([5.0, 60.0, tilts[0], 0.0])
    solution = scipy.optimize.least_squares(residuals, start, x_scale=[1, 1, 1e-3, 1e-3])
    return float(solution.x[0]), float(solution.x[1])


def _pendulum_inertia(robot: RobotPlacement, height: float, plane: SwingPlane) -> float:
    """Hang the stiffened rover from a pivot and time its swing, on the model alone.

    Args:
        robot: Robot, and how it was made.
        height: Height of the centre of gravity above the ground [m].
        plane: Plane in which it swings.

    Returns:
        Inertia about the ground line [kg m^2], less the weighed wheels' share, which the pendulum
        carries along but the suspension leaves on the ground.
    """
    spec = load_part("rover")
    if robot.made is not None:
        alter_rover(spec, robot.made)
    for part in (*spec.actuators, *spec.sensors, *spec.keys, *spec.joints):
        spec.delete(part)
    hung = 0.5  # [m] above the chassis' origin
    pivot = spec.body("chassis").add_joint(name="pivot", type=mujoco.mjtJoint.mjJNT_HINGE)
    pivot.axis, pivot.pos = plane.axis, [0, 0, hung]
    spec.option.timestep = _STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[0] = 0.02
    angles = []
    for _ in range(round(6.0 / _STEP)):
        mujoco.mj_step(model, data)
        angles.append(data.qpos[0])
    mass = float(model.body_subtreemass[0])
    swing = np.array(angles) - np.mean(angles)
    crossings = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    fraction = swing[crossings] / (swing[crossings] - swing[crossings + 1])
    period = np.diff((crossings + fraction) * _STEP).mean()
    bodies = [model.body(f"{wheel}_wheel").id for wheel in WHEELS]
    unswung = mujoco.MjData(model)
    mujoco.mj_forward(model, unswung)
    centre = unswung.subtree_com[0]
    lever = hung - float(centre[2] - unswung.body("chassis").xpos[2])
    about_pivot = mass * GRAVITY * lever * period**2 / (4 * np.pi**2)
    ahead = (unswung.xipos[bodies] - centre) @ plane.along
    wheels = model.body_mass[bodies] @ ahead**2
    return float(about_pivot - mass * lever**2 + mass * height**2 - wheels)
