"""Newton and Euler for the arm on the base, written anew: nothing of the tested code is used."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
EX, EY, EZ = np.eye(3)


def cross(a, b):
    """As numpy's, ten times faster on single vectors."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def hinge_motion(angles, rates):
    """Rotation of the base; E, with body rate omega = E rates; and E_dot rates.

    Hinges about x, y, z, outermost first. Column c of E is an axis seen from the base; the
    hinges inside of that axis turn the base under it, so its rate is -(their rate) x c.
    """
    rotation = Rotation.from_euler("XYZ", angles).as_matrix()
    inner = Rotation.from_euler("Z", angles[2]).as_matrix()
    columns = [(Rotation.from_euler("YZ", angles[1:]).as_matrix()).T @ EX, inner.T @ EY, EZ]
    within = [rates[1] * columns[1] + rates[2] * EZ, rates[2] * EZ]
    bias = -sum(rates[i] * cross(within[i], columns[i]) for i in range(2))
    return rotation, np.array(columns).T, bias


class Plant:
    """One mode of the plant at rest with the arm at 45 degrees.

    `arm` holds mass, principal moments, distance of the centre; `axis` and `turn` how it is held.
    """

    def __init__(self, truth, arm, axis, turn, path):
        self.mass, self.lever = truth["mass"], np.array([truth[n] for n in ("rx", "ry", "rz")])
        t = truth
        self.inertia = np.array(
            [
                [t["ixx"], t["ixy"], t["ixz"]],
                [t["ixy"], t["iyy"], t["iyz"]],
                [t["ixz"], t["iyz"], t["izz"]],
            ]
        )
        names = ("x", "y", "z", "_pitch", "_roll", "_yaw")
        self.damping = np.array([truth[f"b{n}"] for n in names])
        self.stiffness = np.array([truth[f"k{n}"] for n in names])
        self.arm_mass, self.arm_inertia, self.centre = arm[0], np.diag(arm[1]), arm[2]
        self.axis, self.turn, self.path = np.asarray(axis, float), np.asarray(turn, float), path
        still = np.zeros(6)
        self.rest = np.zeros(6)
        wrench, load = self.balance(still, still, still, (np.pi / 4, 0.0, 0.0))
        self.rest_wrench, self.rest = wrench, load

    def arm_at(self, time):
        step = self.path.time_step
        n = min(int(time / step + 1e-9), len(self.path.jerk) - 1)
        t, jerk = time - n * step, self.path.jerk[n]
        angle, rate, acc = self.path.angle[n], self.path.rate[n], self.path.acceleration[n]
        return (
            angle + rate * t + acc * t**2 / 2 + jerk * t**3 / 6,
            rate + acc * t + jerk * t**2 / 2,
            acc + jerk * t,
        )

    def balance(self, position, velocity, acceleration, arm):
        """Wrench on the arm (base frame), and what is missing for equilibrium, (6,)."""
        rotation, rate_matrix, bias = hinge_motion(position[3:], velocity[3:])
        omega, alpha = rate_matrix @ velocity[3:], rate_matrix @ acceleration[3:] + bias
        pose = Rotation.from_rotvec(arm[0] * self.axis).as_matrix() @ self.turn
        centre = pose @ [0.0, self.centre, 0.0]
        lever = self.lever + centre
        spin, spin_rate = arm[1] * self.axis, arm[2] * self.axis
        centre_rate = cross(spin, centre)
        centre_acc = cross(spin_rate, centre) + cross(spin, centre_rate)
        arm_acc = rotation.T @ acceleration[:3] + cross(alpha, lever) + centre_acc
        arm_acc += cross(omega, cross(omega, lever)) + 2 * cross(omega, centre_rate)
        force = self.arm_mass * (arm_acc - rotation.T @ GRAVITY)
        inertia = pose @ self.arm_inertia @ pose.T
        arm_omega = omega + spin
        arm_alpha = alpha + spin_rate + cross(omega, spin)
        moment = inertia @ arm_alpha + cross(arm_omega, inertia @ arm_omega)
        moment += cross(centre, force)
        base = self.inertia @ alpha + cross(omega, self.inertia @ omega)
        base += moment + cross(self.lever, force)
        missing = np.concatenate(
            [
                self.mass * (acceleration[:3] - GRAVITY) + rotation @ force,
                rate_matrix.T @ base,
            ]
        )
        missing += self.damping * velocity + self.stiffness * position - self.rest
        return np.concatenate([force, moment]), missing

    def acceleration(self, time, state):
        arm = self.arm_at(time)
        position, velocity = state[:6], state[6:]
        _, still = self.balance(position, velocity, np.zeros(6), arm)
        columns = [self.balance(position, velocity, unit, arm)[1] - still for unit in np.eye(6)]
        return np.linalg.solve(np.array(columns).T, -still)

    def outputs(self, count):
        """Integrate, and return deviations from rest (count, 24) as the sensors order them."""
        times = self.path.time_step * np.arange(1, count + 1)
        state, rows = np.zeros(12), []
        # The jerk jumps between samples: integrate from one to the next.
        for start, end in zip(times - self.path.time_step, times, strict=True):
            solution = solve_ivp(
                lambda t, y: np.concatenate([y[6:], self.acceleration(t, y)]),
                (start, end - 1e-12),
                state,
                method="Radau",
                rtol=1e-7,
                atol=1e-10,
            )
            state = solution.y[:, -1]
            acc = self.acceleration(end - 1e-12, state)
            wrench, _ = self.balance(state[:6], state[6:], acc, self.arm_at(end - 1e-12))
            motion = [state[:3], state[6:9], acc[:3], state[3:6], state[9:], acc[3:]]
            rows.append(np.concatenate([*motion, wrench - self.rest_wrench]))
        return np.array(rows)
