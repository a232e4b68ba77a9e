"""Commands of another run, once more."""

from collections.abc import Mapping, Sequence

from twin.robot import Command, Observation


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
