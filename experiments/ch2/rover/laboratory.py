"""The rover's true dynamic parameters, measured on the model as in a laboratory.

Thesis section 2.6.2: stiffness by deflection under load, damping by the impulse response fitted to
a second-order equation, inertia by that response and by a pendulum. All without the arm, whose
share the force/torque sensor measures.
"""

import functools

import mujoco
import numpy as np
import scipy.optimize

from models.compose import FLAT, RobotPlacement, load_part, make_model, settle
from models.datasheets import ROVER
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

LOAD = 1.0  # [N] or [N m]: tilts the rover by less than 0.2 degrees
_STEP = 0.00025  # [s]: at 1 ms the inertia would read 1 % too high
_CHASSIS, _MOUNT = "rover1/chassis", "rover1/attachment_site"


class _Bench:
    """The bare rover at rest on the floor of the laboratory."""

    def __init__(self) -> None:
        self.model = make_model(FLAT, [RobotPlacement(arm=False)])
        self.model.opt.timestep = _STEP
        self.rest = settle(self.model, 2.0)
        self.body = self.model.body(_CHASSIS).id
        self.mount = self.rest.site(_MOUNT).xpos.copy()

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
        return self.tilt(data) - self.tilt(self.rest)

    def released(self, seconds: float = 0.6) -> tuple[FloatArray, FloatArray]:
        """Return times and pitch after a pitching moment is let go."""
        data = self.loaded(np.zeros(3), np.array([LOAD, 0.0, 0.0]))
        data.qfrc_applied[:] = 0
        tilts = []
        for _ in range(round(seconds / _STEP)):
            mujoco.mj_step(self.model, data)
            tilts.append(self.tilt(data) - self.tilt(self.rest))
        times = _STEP * np.arange(1.0, len(tilts) + 1)
        return times.astype(np.float64), np.array(tilts)


@functools.lru_cache(maxsize=1)
def laboratory_values() -> dict[str, float]:
    """Return Table 2-2's parameters of the simulated rover, by name, SI units.

    Also "rz_to_centre", the thesis' lever from the centre of gravity, and "ixx_pendulum", the
    inertia about the ground line from the pendulum.
    """
    bench = _Bench()
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
        "ixx_pendulum": _pendulum_inertia(float(centre[2])),
    }


def _second_order(times: FloatArray, tilts: FloatArray) -> tuple[float, float]:
    """Fit a decaying oscillation; return its decay [1/s] and damped frequency [rad/s]."""

    def residuals(x: FloatArray) -> FloatArray:
        wave = x[2] * np.cos(x[1] * times) + x[3] * np.sin(x[1] * times)
        return (np.exp(-x[0] * times) * wave - tilts) / tilts[0]

    start = np.array([5.0, 60.0, tilts[0], 0.0])
    solution = scipy.optimize.least_squares(residuals, start, x_scale=[1, 1, 1e-3, 1e-3])
    return float(solution.x[0]), float(solution.x[1])


def _pendulum_inertia(height: float) -> float:
    """Hang the stiffened rover from a pivot and time its swing, on the model alone.

    Args:
        height: Height of the centre of gravity above the ground [m].

    Returns:
        Inertia about the ground line [kg m^2], less the weighed wheels' share, which the pendulum
        carries along but the suspension leaves on the ground.
    """
    spec = load_part("rover")
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
    mujoco.mj_forward(model, data)
    swing = np.array(angles) - np.mean(angles)
    crossings = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    fraction = swing[crossings] / (swing[crossings] - swing[crossings + 1])
    period = np.diff((crossings + fraction) * _STEP).mean()
    lever = hung - _centre_height(model)
    about_pivot = mass * GRAVITY * lever * period**2 / (4 * np.pi**2)
    wheels = 4 * ROVER.wheel_mass * ROVER.half_wheelbase**2
    return float(about_pivot - mass * lever**2 + mass * height**2 - wheels)


def _centre_height(model: mujoco.MjModel) -> float:
    """Return the height of the centre of gravity above the chassis' origin, unswung [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(data.subtree_com[0][2] - data.body("chassis").xpos[2])
