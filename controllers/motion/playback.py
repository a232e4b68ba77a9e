"""Commands of another run once more, and motions of the arm that were designed before."""

from collections.abc import Mapping, Sequence

import numpy as np

from controllers.motion.arm_move import ArmMove
from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation, WheelMode


class Playback:
    """Gives each robot one command after another, whatever is observed.

    Args:
        commands: Commands of each robot, one a tick, by its name; all equally many.

    Raises:
        ValueError: If they are not.
    """

    def __init__(self, commands: Mapping[str, Sequence[Command]]) -> None:
        counts = {name: len(each) for name, each in commands.items()}
        if len(set(counts.values())) > 1:
            raise ValueError(f"robots with other numbers of commands: {counts}")
        self._commands, self._next = commands, 0

    def reset(self) -> None:
        """Begin anew."""
        self._next = 0

    @property
    def done(self) -> bool:
        """Whether all commands were given."""
        return any(self._next >= len(each) for each in self._commands.values())

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the next command of each robot; none when all were given."""
        if self.done:
            return {}
        self._next += 1
        return {name: each[self._next - 1] for name, each in self._commands.items()}


class MotionPlayer:
    """Moves a robot's arm to the start of a motion, rests there, and plays it; wheels get no duty.

    Args:
        robot: Name of the robot.
        stamps: (n,) times of the motion, rising [s].
        angles: (n, joints) positions of the joints [rad]; between two times on a straight line.
        speed: Speed of the fastest joint on the way to the start [rad/s].
    """

    def __init__(
        self, robot: str, stamps: FloatArray, angles: FloatArray, speed: float = 0.5
    ) -> None:
        self._robot, self._stamps, self._angles, self._speed = robot, stamps, angles, speed
        self._rates = np.gradient(angles, stamps, axis=0)
        self.reset()

    def reset(self) -> None:
        """Go to the start again."""
        self._approach = ArmMove(self._angles[0], self._speed, wheel_mode=WheelMode.DUTY)
        self._begun: float | None = None
        self.played = 0.0

    @property
    def done(self) -> bool:
        """Whether the motion has ended."""
        return self.played >= float(self._stamps[-1] - self._stamps[0])

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the arm's positions and rates at this time of the motion."""
        seen = observations[self._robot]
        if self._begun is None:
            if not self._approach.is_there(seen):
                return {self._robot: self._approach.command(seen)}
            self._begun = seen.time
        self.played = seen.time - self._begun
        time = self._stamps[0] + self.played
        arm, rates = (
            np.array([np.interp(time, self._stamps, column) for column in rows.T])
            for rows in (self._angles, self._rates)
        )
        return {self._robot: Command(arm=arm, arm_mode=ArmMode.POSITION, arm_rates=rates)}
