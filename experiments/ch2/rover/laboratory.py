"""The rover's true dynamic parameters, measured on the model as in a laboratory.

Thesis section 2.6.2: stiffness by deflection under load, damping by the impulse response fitted to
a second-order equation, inertia by that response and by a pendulum. All without the arm, whose
share the force/torque sensor measures.

A robot as made has four different springs and masses off its middle, so its pitch is coupled with
roll and heave, a little. What is measured then is what a laboratory would: the pitch that a
pitching moment or a force in the robot's plane of symmetry gives at rest, and the frequency and
decay of the one oscillation that fits the released pitch best. Five numbers describe no coupled
robot fully; these are the ones nearest to it as pitch alone shows it.
"""

import functools

import mujoco
import numpy as np
import scipy.optimize

from models.as_made import alter_rover
from models.compose import LABORATORY, WHEELS, RobotPlacement, load_part, make_model, settle
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

LOAD = 1.0  # [N] or [N m]: tilts the rover by less than 0.2 degrees
_STEP = 0.00025  # [s]: at 1 ms the inertia would read 1 % too high


class _Bench:
    """The bare rover at rest on the floor of the laboratory."""

    def __init__(self, robot: RobotPlacement) -> None:
        bare = RobotPlacement(robot.name, arm=False, made=robot.made)
        self.model = make_model(LABORATORY, [bare])
        self.model.opt.timestep = _STEP
        self.rest = settle(self.model, 2.0)
        self.body = self.model.body(f"{robot.name}/chassis").id
        self.mount = self.rest.site(f"{robot.name}/attachment_site").xpos.copy()
        # MuJoCo's dry friction creeps: a robot as made, which does not weigh alike on its wheels,
        # rolls by micrometres meanwhile. So what is compared has waited as long.
        self.unloaded = self.tilt(self.loaded(np.zeros(3), np.zeros(3)))

    def tilt(self, data: mujoco.MjData) -> float:
        """Return the pitch [rad]: the elevation of the chassis' y axis."""
        return float(np.arcsin(data.xmat[self.body].reshape(3, 3)[2, 1]))

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

    def deflection(self, force: tuple[float, float, float], torque: float = 0.0) -> float:
        """Return the change of pitch under a load [rad]."""
        data = self.loaded(np.array(force), np.array([torque, 0.0, 0.0]))
        return self.tilt(data) - self.unloaded

    def released(self, seconds: float = 0.6) -> tuple[FloatArray, FloatArray]:
        """Return times and pitch after a pitching moment is let go."""
        data = self.loaded(np.zeros(3), np.array([LOAD, 0.0, 0.0]))
        data.qfrc_applied[:] = 0
        tilts = []
        for _ in range(round(seconds / _STEP)):
            mujoco.mj_step(self.model, data)
            tilts.append(self.tilt(data) - self.unloaded)
        times = _STEP * np.arange(1.0, len(tilts) + 1)
        return times.astype(np.float64), np.array(tilts)


@functools.lru_cache
def laboratory_values(robot: RobotPlacement = RobotPlacement()) -> dict[str, float]:  # noqa: B008
    """Return Table 2-2's parameters of a simulated rover, by name, SI units.

    Also "rz_to_centre", the thesis' lever from the centre of gravity, and "ixx_pendulum", the
    inertia about the ground line from the pendulum.

    Args:
        robot: Robot, whose arm is taken off; `RobotPlacement.made` says how it was made.
    """
    bench = _Bench(robot)
    stiffness = LOAD / bench.deflection((0.0, 0.0, 0.0), LOAD)
    times, tilts = bench.released()
    decay, frequency = _second_order(times, tilts)
    inertia = stiffness / (decay**2 + frequency**2)
    centre = bench.rest.subtree_com[bench.body]
    return {
        "ixx": inertia,
        "ry": bench.deflection((0.0, 0.0, LOAD)) * stiffness / LOAD,
        "rz": -bench.deflection((0.0, LOAD, 0.0)) * stiffness / LOAD,
        "b_pitch": 2 * decay * inertia,
        "k_pitch": stiffness,
        "rz_to_centre": float(bench.mount[2] - centre[2]),
        "ixx_pendulum": _pendulum_inertia(robot, float(centre[2])),
    }


def _second_order(times: FloatArray, tilts: FloatArray) -> tuple[float, float]:
    """Fit a decaying oscillation; return its decay [1/s] and damped frequency [rad/s]."""

    def residuals(x: FloatArray) -> FloatArray:
        wave = x[2] * np.cos(x[1] * times) + x[3] * np.sin(x[1] * times)
        return (np.exp(-x[0] * times) * wave - tilts) / tilts[0]

    start = np.array([5.0, 60.0, tilts[0], 0.0])
    solution = scipy.optimize.least_squares(residuals, start, x_scale=[1, 1, 1e-3, 1e-3])
    return float(solution.x[0]), float(solution.x[1])


def _pendulum_inertia(robot: RobotPlacement, height: float) -> float:
    """Hang the stiffened rover from a pivot and time its swing, on the model alone.

    Args:
        robot: Robot, and how it was made.
        height: Height of the centre of gravity above the ground [m].

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
    pivot.axis, pivot.pos = [1, 0, 0], [0, 0, hung]
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
    ahead = unswung.xipos[bodies, 1] - centre[1]
    wheels = model.body_mass[bodies] @ ahead**2
    return float(about_pivot - mass * lever**2 + mass * height**2 - wheels)
