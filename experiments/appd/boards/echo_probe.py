"""A process that echoes what it receives: the least time that boards behind a port can take."""

import select
import sys

from twin.hardware.emulator.ports import PseudoTerminal


def main() -> None:
    """Print the port's name and echo until the standard input is closed."""
    port = PseudoTerminal()
    print(port.name, flush=True)
    while sys.stdin not in select.select([port, sys.stdin], [], [])[0]:
        port.write(port.read())
    port.close()


if __name__ == "__main__":
    main()
