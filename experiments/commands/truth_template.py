"""``truth-template``: a file of true parameters, for ``ch2-simulation --truth``."""

from controllers.identification.parameters import NAMES, UNITS
from experiments.ch2.simulation.truths import TABLE_TRUTH
from experiments.commands.truth_template_options import Options

_HEAD = """\
# True parameters of the simplified rover: a base on springs and dampers, and the arm's mount.
# Frame II lies at the base's centre of gravity: x right, y forward, z up; pitch, roll and yaw turn
# about x, y and z. Change the values, and keep the names. Table 2-1's are these.
"""
_PARTS = {
    "mass": "base",
    "ixx": "its inertia tensor",
    "rx": "mount of the arm, from the centre of gravity",
    "bx": "dampers",
    "kx": "springs",
}


def run(options: Options) -> int:
    """Print a TOML file with Table 2-1's values.

    Args:
        options: None.

    Returns:
        0.
    """
    del options
    print(_HEAD, end="")
    for name, unit, value in zip(NAMES, UNITS, TABLE_TRUTH):
        if name in _PARTS:
            print(f"\n# {_PARTS[name]}")
        print(f"{f'{name} = {value}':20}  # [{unit}]")
    return 0
