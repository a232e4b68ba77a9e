"""A process that sends back what it hears: the least that boards behind a port can cost."""

import select
import sys

from twin.hardware.emulator.ports import PseudoTerminal


def main() -> None:
    """Print the port's name and echo until the standard input is closed."""
    port = PseudoTerminal()
    print(port.name, flush=True)
    while True:
        ready, _, _ = select.select([port, sys.stdin], [], [])
        if sys.stdin in ready:
            break
        port.write(port.read())
    port.close()


if __name__ == "__main__":
    main()
