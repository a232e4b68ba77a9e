"""Control of the arm on its yielding base (Thesis section A.1, step 3, eq. A-4).

The arm follows a reference by proportional and derivative feedback, plus gravity, plus what the
base's motion demands of the joints, F d'' + f d' of eq. A-4. Efforts go out through the robot's
contract; the servo turns them into duty.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.base_motion import LAG, BaseMotionFilter, level_of
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_choice, check_numbers
from twin.robot import ArmMode, Command, Observation, RobotError

Law = Literal["pd", "pd_gravity", "feed_forward"]
LAWS: tuple[Law, ...] = ("pd", "pd_gravity", "feed_forward")


@dataclasses.dataclass(frozen=True)
class Reference:
    """Reference of the joints.

    Attributes:
        angles: (4,) [rad].
        rates: (4,) [rad/s].
        accelerations: (4,) [rad/s^2].
    """

    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray


@dataclasses.dataclass(frozen=True)
class ArmGains:
    """Feedback that gives every joint the same second-order response.

    The gains are these times the arm's mass matrix where it is, K_p = w^2 H and K_D = 2 z w H:
    symmetric and positive definite as step 3 requires, and as right for a heavy load as for none.

    Attributes:
        frequency: w [rad/s]; a 100 Hz servo carries some 30.
        damping: z, ratio to critical damping.
    """

    frequency: float = 20.0
    damping: float = 1.0

    def __post_init__(self) -> None:
        """Refuse gains that do not pull back.

        Raises:
            ValueError: Naming the number and what is valid.
        """
        check_numbers("arm", self)


@dataclasses.dataclass(frozen=True)
class ArmControlConfig:
    """Configuration of the arm's controller.

    Attributes:
        robot: Name of the robot that it drives.
        chain: The arm above its base, rotors included.
        mount: (3,) the arm's base from the accelerometer, in the body frame [m].
        gains: Feedback.
        law: ``pd``, ``pd_gravity`` or ``feed_forward``.
        lag: Time constant of the lag of the base's motion before it is fed forward [s].
        friction: (4,) dry friction of the joints [N m], fed forward along the reference's rate in
            every law.
        motor_damping: (4,) back-EMF of the joints' motors [N m s/rad]. The servo compensates it as
            it is when a tick begins; the reference's change until its middle is fed forward.
        period: Servo tick [s].
        most: Largest effort of a joint [N m].
    """

    robot: str
    chain: SerialChain
    mount: FloatArray
    gains: ArmGains = dataclasses.field(default_factory=ArmGains)
    law: Law = "feed_forward"
    lag: float = LAG
    friction: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(4))
    motor_damping: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(4))
    period: float = 0.01
    most: float = 8.0

    def __post_init__(self) -> None:
        """Refuse an unknown law.

        Raises:
            ValueError: Naming it and the valid ones.
        """
        check_choice("law", self.law, LAWS)


class ArmController:
    """Drives one robot's arm along a reference; the wheels stay braked.

    Args:
        config: Model of the arm, control law and gains.
        reference: Function that gives the reference at a time since the first step [s].

    Attributes:
        fed_forward: Whether the last step fed the base's motion forward.
    """

    def __init__(self, config: ArmControlConfig, reference: Callable[[float], Reference]) -> None:
        self._config = config
        self._reference = reference
        self._filter = BaseMotionFilter(config.lag, config.period)
        self.reset()

    def reset(self) -> None:
        """Forget all samples; the reference starts anew."""
        self._filter.reset()
        self._start: float | None = None
        self.fed_forward = False

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the arm's efforts.

        Without accelerometer or gyro the base's motion is not fed forward: see `fed_forward`.

        Raises:
            RobotError: If joint angles or rates are missing or stale.
        """
        seen = observations[self._config.robot]
        for name in ("arm_angles", "arm_rates"):
            channel = getattr(seen, name)
            if not channel.usable:
                raise RobotError(f"arm control needs {name}, which is {channel.validity.value}")
        if self._start is None:
            self._start = seen.time
        wanted = self._reference(seen.time - self._start)
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        rates = np.asarray(seen.arm_rates.value, dtype=float)
        gains, chain = self._config.gains, self._config.chain
        pull = gains.frequency**2 * (wanted.angles - angles)
        pull += 2.0 * gains.damping * gains.frequency * (wanted.rates - rates)
        efforts = chain.mass_matrix(angles) @ pull
        middle = self._reference(seen.time - self._start + 0.5 * self._config.period)
        efforts += self._config.friction * np.tanh(middle.rates / 0.02)
        efforts += self._config.motor_damping * (middle.rates - wanted.rates)
        efforts += self._model(middle, angles, rates, seen)
        limit = self._config.most
        arm = np.clip(efforts, -limit, limit)
        return {self._config.robot: Command(arm=arm, arm_mode=ArmMode.EFFORT)}

    def _model(
        self, wanted: Reference, angles: FloatArray, rates: FloatArray, seen: Observation
    ) -> FloatArray:
        """Return the terms of eq. A-4 that the law feeds forward (4,) [N m]."""
        chain, law = self._config.chain, self._config.law
        still = np.zeros(len(chain))
        efforts = chain.inverse_dynamics(angles, wanted.rates, wanted.accelerations)[0]
        efforts -= chain.bias(angles, still)
        motion = self._filter.update(seen) if law == "feed_forward" else None
        self.fed_forward = motion is not None
        if motion is not None:
            # Without what the joints' own rates do: that is in the reference's part.
            efforts += chain.bias(angles, rates, motion.at(self._config.mount))
            efforts -= chain.bias(angles, rates) - chain.bias(angles, still)
        elif law != "pd":
            efforts += chain.bias(angles, still, level_of(seen))
        return efforts
