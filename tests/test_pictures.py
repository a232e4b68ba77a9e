"""Every picture of the pages has a recipe that could make it anew."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from PIL import Image

from models import write_scenes
from tests.test_readme_commands import LINK, PAGES, check, experiment_words
from tools import draw_concepts, make_pictures

ROOT = Path(__file__).parent.parent
PICTURE = (".png", ".gif", ".svg", ".jpg", ".webp")
RECIPES = make_pictures.RECIPES
LARGEST_DRAWING = 100_000  # [bytes]


def shown_on(page):
    """Return the pictures that a page shows or links to, by their paths in the repository."""
    folder = (ROOT / page).parent
    links = [link.partition("#")[0] for link in LINK.findall((ROOT / page).read_text())]
    pictures = [link for link in links if link.endswith(PICTURE) and "://" not in link]
    return {str((folder / each).resolve().relative_to(ROOT)) for each in pictures}


def test_every_picture_has_one_recipe_and_every_recipe_a_picture():
    shown = set().union(*map(shown_on, PAGES))
    made = [path for recipe in RECIPES for path in recipe.pictures]
    assert sorted(shown) == sorted(made)
    assert len(shown) > 20  # noqa: PLR2004
    texture = f"models/field/{write_scenes.PICTURE}"  # Of a scene, shown on no page.
    stored = [
        str(path.relative_to(ROOT))
        for folder in ("docs", "models")
        for path in (ROOT / folder).rglob("*")
        # `docs/measured` holds stored jobs; pictures made of them there are shown elsewhere.
        if path.suffix in PICTURE and ROOT / "docs" / "measured" not in path.parents
    ]
    assert sorted(stored) == sorted([*made, texture])


@pytest.mark.parametrize("line", [line for each in RECIPES for line in each.command.splitlines()])
def test_a_recipe_runs_what_exists(line):
    first, *words = line.split()
    if words and words[0] == "experiments":
        check(experiment_words(f"python {line}"))
    elif first == "-m":
        assert importlib.util.find_spec(words[0]) is not None
    else:
        assert (ROOT / first).is_file()


def test_drawings_are_small_and_whole(tmp_path):
    draw_concepts.main(tmp_path)
    drawn = sorted(path.name for path in tmp_path.iterdir())
    assert drawn == sorted(path.name for path in draw_concepts.FOLDER.iterdir())
    for path in tmp_path.iterdir():
        assert ElementTree.parse(path).getroot().tag.endswith("svg")
        assert path.stat().st_size < LARGEST_DRAWING
        # The committed one is of the same size on the page.
        ours, theirs = (
            ElementTree.parse(folder / path.name).getroot().get("viewBox").split()
            for folder in (tmp_path, draw_concepts.FOLDER)
        )
        assert list(map(float, ours)) == pytest.approx(list(map(float, theirs)), rel=0.01)


def test_a_picture_is_shown_as_wide_and_in_as_many_colours_as_said(tmp_path):
    Image.radial_gradient("L").resize((400, 200)).convert("RGB").save(tmp_path / "drawn.png")
    shown = make_pictures.Shown("OUT/drawn.png", 100, 8)
    make_pictures.put(shown, tmp_path, tmp_path / "shown.png")
    picture = Image.open(tmp_path / "shown.png")
    assert picture.size == (100, 50)
    assert len(picture.getcolors()) <= 8  # noqa: PLR2004
    whole = make_pictures.Shown("OUT/drawn.png")
    make_pictures.put(whole, tmp_path, tmp_path / "whole.png")
    assert (tmp_path / "whole.png").read_bytes() == (tmp_path / "drawn.png").read_bytes()


def test_a_picture_that_nobody_knows_is_refused_with_those_that_there_are():
    result = subprocess.run(
        [sys.executable, ROOT / "tools" / "make_pictures.py", "docs/moon.gif"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert re.match(r"no picture docs/moon\.gif; there are .*docs/mapping\.gif", result.stderr)
    assert result.stderr.count("\n") == 1
