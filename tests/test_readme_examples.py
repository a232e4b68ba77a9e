"""Every Python example of README.md and the pages in docs, run, and its output compared."""

import contextlib
import dataclasses
import io
import re
import sys
import types
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = (
    "README.md",
    "docs/extending.md",
    "docs/parts.md",
    "docs/running.md",
    *(
        f"docs/tutorials/{name}.md"
        for name in ("camera", "floor_plan", "identify", "insertion", "sensor")
    ),
)
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
TOLERANCE = 0.05
"""Share by which a printed number may differ, beside one unit of its last place: physics is not the
same to the bit on every processor."""


@dataclasses.dataclass(frozen=True)
class Example:
    """A Python block of a page, and the text block after it."""

    page: str
    line: int
    code: str
    output: str

    def __str__(self):
        return f"{self.page}:{self.line}"


def examples(page: str, text: str) -> list[Example]:
    """Return the examples of a page.

    Raises:
        ValueError: If an example's output is not shown right after it.
    """
    found = []
    for fence in FENCE.finditer(text):
        if fence[1] != "python":
            continue
        line = text.count("\n", 0, fence.start()) + 1
        rest = text[fence.end() :].lstrip()
        following = FENCE.match(rest)
        if following is None or following[1] != "text":
            raise ValueError(f"{page}:{line}: no block of text with its output follows")
        found.append(Example(page, line, fence[2], following[2]))
    return found


def printed(example: Example) -> str:
    """Run an example in a module of its own and return what it prints."""
    module = types.ModuleType(f"example_{example.page.split('.')[0].replace('/', '_')}")
    sys.modules[module.__name__] = module
    # So that a traceback names the line of the page.
    code = compile("\n" * example.line + example.code, example.page, "exec")
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(out):
            exec(code, module.__dict__)
    finally:
        del sys.modules[module.__name__]
    return out.getvalue()


def agree(ours: str, shown: str) -> bool:
    """Return whether two texts are alike but for spaces and, within the tolerance, numbers."""
    words = [" ".join(NUMBER.sub(" # ", text).split()) for text in (ours, shown)]
    if words[0] != words[1]:
        return False
    for mine, theirs in zip(NUMBER.findall(ours), NUMBER.findall(shown), strict=True):
        decimals = len(theirs.partition(".")[2]) if "e" not in theirs.lower() else 0
        if "." not in theirs and "." not in mine and "e" not in theirs.lower():
            slack = 0.0  # A count is exact.
        else:
            slack = max(1.0001 * 10.0**-decimals, TOLERANCE * abs(float(theirs)))
        if abs(float(mine) - float(theirs)) > slack:
            return False
    return True


EXAMPLES = [each for page in PAGES for each in examples(page, (ROOT / page).read_text())]


@pytest.mark.chosen_seed
@pytest.mark.parametrize("example", EXAMPLES, ids=str)
def test_example_prints_what_the_page_shows(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # One of them writes results.
    monkeypatch.setenv("COLUMNS", "80")
    output = printed(example)
    assert agree(output, example.output), f"{example} prints now:\n{output}"


def test_every_page_with_examples_is_among_them():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    with_examples = {
        str(page.relative_to(ROOT)) for page in pages if "```python" in page.read_text()
    }
    assert with_examples == set(PAGES) == {each.page for each in EXAMPLES}


def test_readme_is_short():
    assert (ROOT / "README.md").stat().st_size <= 12_000


PAGE = "# Page\n\n```python\nprint('mass', 2.0 {})\n```\n\n```text\nmass 2.05\n```\n"


def test_an_output_that_went_stale_is_seen():
    (example,) = examples("page.md", PAGE.format("+ 0.1"))
    assert agree(printed(example), example.output)  # within 5 %
    (stale,) = examples("page.md", PAGE.format("+ 0.3"))
    assert not agree(printed(stale), stale.output)
    assert not agree("weight 2.05\n", example.output)
    assert not agree("mass 2.05\nmass 2.05\n", example.output)
    assert not agree("mass nan\n", example.output)
    assert not agree("300 ticks", "301 ticks")


def test_an_example_that_no_longer_runs_is_seen():
    (example,) = examples("page.md", PAGE.format("+ gone"))
    with pytest.raises(NameError, match="gone"):
        printed(example)


def test_an_example_without_its_output_is_refused():
    text = PAGE.format("").replace("```text", "```sh")
    with pytest.raises(ValueError, match=r"page\.md:3: no block of text"):
        examples("page.md", text)
