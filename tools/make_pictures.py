"""Make the pictures of README, docs and models anew: ``python tools/make_pictures.py --help``.

Each picture has a command here that makes it. Where a page shows it smaller than it was drawn, or
with fewer colours, that is stated here, too.
"""

import dataclasses
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import tyro
from PIL import Image

ROOT = Path(__file__).parent.parent
OUT = "OUT"
"""Stands in a command for the folder that it writes to."""


@dataclasses.dataclass(frozen=True)
class Shown:
    """How a page shows a picture.

    Attributes:
        file: File that the command writes; below `OUT`, or in the repository.
        width: Width on the page [px]; None as drawn.
        colours: Number of colours; None as drawn.
    """

    file: str
    width: int | None = None
    colours: int | None = None


@dataclasses.dataclass(frozen=True)
class Recipe:
    """A command and the pictures that it makes.

    Attributes:
        command: Arguments of Python, several lines for one after the other.
        pictures: How each picture is shown, by its path in the repository.
        takes: How long the command takes, as far as it was measured.
    """

    command: str
    pictures: Mapping[str, Shown]
    takes: str = "not measured"


def _experiment(command: str, pictures: Mapping[str, Shown], takes: str = "not measured") -> Recipe:
    """Return the recipe of an experiment, whose files are named relative to its result folder."""
    name = command.split(maxsplit=1)[0]
    files = {
        path: dataclasses.replace(shown, file=f"{OUT}/{name}/{shown.file}")
        for path, shown in pictures.items()
    }
    return Recipe(f"-m experiments {command} --out {OUT}", files, takes)


def _in_place(command: str, folder: str, names: Sequence[str], takes: str) -> Recipe:
    """Return the recipe of a command that writes its pictures where they are shown."""
    paths = [f"{folder}/{name}" for name in names]
    return Recipe(command, {path: Shown(path) for path in paths}, takes)


RECIPES = (
    _in_place(
        "tools/draw_concepts.py",
        "docs/drawings",
        [
            "contract.svg", "lifecycle.svg", "drawn_and_made.svg", "belief.svg",
            "rover_frames.svg", "camera_frame.svg", "card_frames.svg",
        ],
        "seconds",
    ),
    _in_place(
        "-m models.render_pictures",
        "models",
        [
            "rover/rover.png", "arm/arm.png", "stereo_head/stereo_head.png", "field/field.png",
            "card_and_slot/card_and_slot.png", "card_and_slot/guides.png", "braid/braid.png",
            "compliant_base/compliant_base.png",
        ],
        "half a minute",
    ),
    Recipe(
        f"-m experiments.ch2.rover.movie {OUT}/excitation.gif",
        {"docs/excitation.gif": Shown(f"{OUT}/excitation.gif")},
        "half a minute",
    ),
    Recipe(
        f"-m experiments.ch3.planar.movie {OUT}/mapping.gif",
        {"docs/mapping.gif": Shown(f"{OUT}/mapping.gif")},
        "half a minute",
    ),
    _experiment(
        "mission --quick --record", {"docs/mission.gif": Shown("mission.gif")}, "four minutes"
    ),
    _experiment(
        "ch2-rover", {"docs/figure_2-12.png": Shown("figures/figure_2-12.png")}, "four minutes"
    ),
    _experiment(
        "ch2-diagnosis --seed 71",
        {"docs/changes.png": Shown("figures/changes.png")},
        "seven minutes",
    ),
    _experiment(
        "ch3-planar", {"docs/figure_3-13.png": Shown("figures/figure_3-13.png")}, "twelve minutes"
    ),
    _experiment(
        "ch3-stereo",
        {
            "docs/figure_3-22.png": Shown("figures/figure_3-22.png", 600, 256),
            "docs/figure_3-25.png": Shown("figures/figure_3-25.png"),
            "docs/figure_3-27b.png": Shown("figures/figure_3-27b.png", 1000, 256),
        },
        "ten minutes",
    ),
    _experiment("ch4-planar", {"docs/approach.gif": Shown("approach.gif")}, "three minutes"),
    _experiment(
        "ch4-stereo",
        {"docs/figure_4-12.png": Shown("figures/figure_4-12.png", 1100, 256)},
        "three minutes",
    ),
    _experiment(
        "ch4-montecarlo", {"docs/table_4-1.png": Shown("figures/table_4-1.png")}, "one minute"
    ),
    _experiment(
        "ch5-insertion --seed 1",
        {
            "docs/figure_5-12.png": Shown("figures/figure_5-12.png", 579, 256),
            "docs/table_5-1.png": Shown("figures/table_5-1.png"),
        },
        "an hour",
    ),
    Recipe(
        "-m experiments mission-envelope --seed 9119 --out docs/measured --resume",
        {"docs/envelope.png": Shown("docs/measured/mission-envelope/figures/envelope.png")},
        "seconds, of the insertions and missions kept there",
    ),
    Recipe(
        "-m experiments own-robot --seed 2310 --out docs/measured --resume",
        {"docs/own_robot.png": Shown("docs/measured/own-robot/figures/deviations.png", 1100, 64)},
        "seconds, of the robots kept there",
    ),
    Recipe(
        f"-m experiments ch5-insertion --quick --record --out {OUT}\n"
        f"-m twin.recording.record screenshot {OUT}/ch5-insertion/run.rrd {OUT}/viewer.png",
        {"docs/viewer.png": Shown(f"{OUT}/viewer.png", 1200, 64)},
        "two minutes",
    ),
    _experiment(
        "appd-boards", {"docs/fault_stops.png": Shown("figures/fault_stops.png")}, "four minutes"
    ),
    _experiment(
        "bench --only markers",
        {"docs/fiducials.png": Shown("figures/fiducials.png")},
        "ten minutes",
    ),
)  # fmt: skip


def make(recipe: Recipe, wanted: Sequence[str]) -> None:
    """Run a recipe's command and put its pictures in place.

    Args:
        recipe: The recipe.
        wanted: Paths of the pictures to put in place, in the repository.

    Raises:
        subprocess.CalledProcessError: If the command fails.
    """
    with tempfile.TemporaryDirectory() as out:
        for line in recipe.command.splitlines():
            words = [word.replace(OUT, out) for word in line.split()]
            subprocess.run([sys.executable, *words], cwd=ROOT, check=True)
        for path in wanted:
            put(recipe.pictures[path], Path(out), ROOT / path)


def put(shown: Shown, out: Path, target: Path) -> None:
    """Put a picture in place, as it is shown.

    Args:
        shown: How it is shown.
        out: Folder that `OUT` stands for.
        target: File to write.
    """
    source = Path(
        str(ROOT / shown.file) if OUT not in shown.file else shown.file.replace(OUT, str(out))
    )
    if shown.width is None and shown.colours is None:
        if source != target:
            shutil.copy(source, target)
        return
    picture = Image.open(source).convert("RGB")
    if shown.width is not None:
        height = round(picture.height * shown.width / picture.width)
        picture = picture.resize((shown.width, height), Image.Resampling.LANCZOS)
    if shown.colours is not None:
        picture = picture.quantize(shown.colours)
    picture.save(target, optimize=True)


def main(
    pictures: Annotated[tuple[str, ...], tyro.conf.Positional] = (), /, show: bool = False
) -> None:
    """Make pictures anew; without names all of them, which takes many hours.

    For example: python tools/make_pictures.py docs/mapping.gif

    Args:
        pictures: Paths of pictures, such as docs/mapping.gif.
        show: Only list each picture with its command.
    """
    known = [path for recipe in RECIPES for path in recipe.pictures]
    if unknown := [path for path in pictures if path not in known]:
        sys.exit(f"no picture {', '.join(unknown)}; there are {', '.join(sorted(known))}")
    for recipe in RECIPES:
        wanted = [path for path in recipe.pictures if path in (pictures or known)]
        if wanted:
            commands = " && ".join(f"python {line}" for line in recipe.command.splitlines())
            print(f"{commands}  ({recipe.takes})", *wanted, sep="\n    ", flush=True)
            if not show:
                make(recipe, wanted)


if __name__ == "__main__":
    tyro.cli(main)
