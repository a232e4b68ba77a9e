import re
from pathlib import Path

import pytest

import experiments
from experiments.harness.catalogue import EXPERIMENTS
from experiments.harness.thesis_elements import Element, Reason, elements, reasons, why

# Last figure and last table of each chapter and appendix; the thesis has no figure E-6.
LAST = {
    "1": (5, 0), "2": (12, 2), "3": (27, 0), "4": (13, 1), "5": (14, 1), "A": (12, 0),
    "B": (5, 0), "C": (2, 1), "D": (4, 2), "E": (9, 0),
}  # fmt: skip


def test_every_table_and_figure_of_the_thesis_is_there():
    expected = {
        f"{kind} {chapter}-{number}"
        for chapter, counts in LAST.items()
        for kind, count in zip(("Figure", "Table"), counts, strict=True)
        for number in range(1, count + 1)
    } - {"Figure E-6"}
    assert {element.name for element in elements()} == expected


def test_elements_and_reasons_name_experiments_that_exist():
    names = {name for element in elements() for name in element.shown_by}
    assert names <= set(EXPERIMENTS)
    assert {reason.experiment for reason in reasons()} <= set(EXPERIMENTS)


def test_some_experiment_makes_a_picture_or_table_for_every_element_without_excuse():
    files = Path(experiments.__file__).parent.rglob("*.py")
    words = {word for path in files for word in re.findall(r'"([\w-]+)"', path.read_text())}
    wanted = [element for element in elements() if not element.why_not]
    others = {stem for element in wanted for stem in element.also}
    assert others <= words
    # Some names are put together from "figure" and a number.
    numbered = {word for word in words if "-" in word}
    stems = others | numbered | {f"figure_{word}" for word in numbered}
    assert [e.name for e in wanted if not any(map(e.shown_in, stems))] == []


def test_files_that_excuses_point_to_exist():
    root = Path(__file__).parents[3]
    for element in elements():
        for word in element.why_not.replace(",", " ").replace(":", " ").split():
            if "/" in word:
                assert list(root.glob(word.strip(".;()"))), word


@pytest.mark.parametrize(
    ("name", "stem", "shown"),
    [
        ("Figure 3-26", "figure_3-26a", True),
        ("Figure 3-2", "figure_3-26a", False),
        ("Figure A-6", "figure_a-5_a-6", True),
        ("Figure C-2", "table_C-2", False),
        ("Table D-1", "table_d-1", True),
        ("Figure 4-12", "figure_4-12_wall", True),
        ("Figure 4-12", "searches", False),
    ],
)
def test_a_picture_belongs_to_an_element_by_its_name(name, stem, shown):
    assert Element(name, "", ("bench",)).shown_in(stem) is shown


def test_elements_without_picture_or_excuse_are_refused():
    with pytest.raises(ValueError, match="Figure 2-4: neither shown_by nor why_not"):
        Element("Figure 2-4", "")
    with pytest.raises(ValueError, match="'Fig 2' *: expected"):
        Element("Fig 2", "", ("bench",))


def test_a_reason_is_known_by_experiment_and_pattern():
    known = [Reason("bench", ("loop *",), "cold caches")]
    assert why(known, "bench", "loop overhead, plane") == "cold caches"
    assert why(known, "bench", "mapping") == "" == why(known, "mission", "loop overhead, plane")
