"""Commands and links of the Markdown pages: each experiment, option, module and file exists."""

import importlib.util
import re
import shlex
from pathlib import Path

import pytest

from experiments.harness import catalogue, command_line
from experiments.harness.contract import OptionError

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    str(path.relative_to(ROOT))
    for pattern in (
        "*.md",
        "docs/*.md",
        "docs/tutorials/*.md",
        "models/*/*.md",
        "twin/hardware/*.md",
    )
    for path in ROOT.glob(pattern)
)
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
MODULE = re.compile(r"(?:^|/)python -m ([\w.]+)\s*(.*)")
ELLIPSIS = ("serial:...", "serial:/dev/ttyUSB0,analogue=/dev/ttyACM0,wrench=192.168.1.1")
"""What a page leaves out, and what may stand there."""
TARGET = re.compile(r"(?:^|&& )make ([a-z]+)")


def commands(text: str) -> list[str]:
    """Return the commands in a page's code, without comments; of prose only what is in quotes."""
    blocks = [body for language, body in FENCE.findall(text) if language != "python"]
    lines = [line.split("  # ")[0].strip() for block in blocks for line in block.splitlines()]
    spans = SPAN.findall(" ".join(FENCE.sub("", text).split("\n")))
    return [" ".join(line.split("    #")[0].split()) for line in (*lines, *spans)]


def experiment_words(command: str) -> list[str]:
    """Return name and options of a command of the experiments, nothing of another one.

    In prose "python -m experiments" may be left out where options follow.
    """
    match = MODULE.search(command)
    if match:
        words, _, _ = match[2].replace(*ELLIPSIS).partition(" > ")
        return shlex.split(words) if match[1] == "experiments" else []
    words = command.replace(*ELLIPSIS).split()
    known = catalogue.EXPERIMENTS.keys() | catalogue.COMMANDS.keys()
    return words if len(words) > 1 and words[0] in known and words[1].startswith("--") else []


def check(words: list[str]) -> None:
    """Parse a command of the experiments without running it.

    Raises:
        OptionError: If there is no such experiment or option.
    """
    name, *options = words
    if name in ("NAME", "--help"):
        return
    known = {**catalogue.EXPERIMENTS, **catalogue.COMMANDS}
    if name not in known:
        raise OptionError(f"no experiment {name!r}")
    command_line.parse(known[name], options)


@pytest.mark.parametrize("page", [page for page in PAGES if page != "CHANGELOG.md"])
def test_commands_name_what_exists(page):
    wrong = []
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    seen = dict.fromkeys(commands((ROOT / page).read_text()))
    for command in seen:
        if words := experiment_words(command):
            try:
                check(words)
            except OptionError as error:
                wrong.append(f"{command}: {error}")
        elif (match := MODULE.search(command)) and importlib.util.find_spec(match[1]) is None:
            wrong.append(f"{command}: no module {match[1]}")
        if (match := TARGET.search(command)) and match[1] not in targets:
            wrong.append(f"{command}: no target {match[1]}")
    assert wrong == []


def test_readme_names_every_experiment():
    named = {line.split()[0] for line in commands((ROOT / "README.md").read_text()) if line}
    assert set(catalogue.EXPERIMENTS) - named == set()


@pytest.mark.parametrize("words", ["ch9-moon", "ch2-rover --robots sim", "report --quick"])
def test_a_command_that_went_stale_is_seen(words):
    (command,) = commands(f"```\n.venv/bin/python -m experiments {words}   # why\n```\n")
    with pytest.raises(OptionError):
        check(experiment_words(command))


def anchors(text: str) -> set[str]:
    """Return what a page's headings are linked by."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings(page):
    path = ROOT / page
    broken = []
    for link in LINK.findall(FENCE.sub("", path.read_text())):
        if "://" in link:
            continue
        name, _, heading = link.partition("#")
        target = path.parent / name if name else path
        if not target.exists() or (heading and heading not in anchors(target.read_text())):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", PAGES)
def test_named_files_of_the_repository_exist(page):
    """Paths in quotes with a folder in front, but for placeholders and results."""
    folders = (
        "models/",
        "twin/",
        "perception/",
        "controllers/",
        "experiments/",
        "tests/",
        "tools/",
    )
    spans = SPAN.findall(FENCE.sub("", (ROOT / page).read_text()))
    named = [span for span in spans if re.fullmatch(r"[\w./-]+", span) and span.startswith(folders)]
    assert [name for name in named if not (ROOT / name).exists()] == []
