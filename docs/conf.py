"""Configuration of the site, which `make docs` builds from the Markdown pages and the docstrings.

The source folder is the repository itself, so that each page is read where it lives and its links
lead to the same places here and in the checkout.
"""

import ast
import inspect
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from math_core import LatexToMathML
from sphinx.addnodes import pending_xref
from sphinx.pycode import ModuleAnalyzer

# Compiled functions hide their signatures and docstrings from Sphinx; plain ones do not.
os.environ["NUMBA_DISABLE_JIT"] = "1"

ROOT = Path(__file__).parent.parent
PACKAGES = ("twin", "perception", "controllers")
REFERENCE = "docs/reference"
"""Folder of the generated pages, one for each package; git ignores it."""

CONTENTS = {
    "Start": ["docs/installing", "docs/path", "docs/running"],
    "Concepts": ["docs/concepts", "docs/frames"],
    "Chapters": [*(f"docs/chapter_{number}" for number in (2, 3, 4, 5)), "docs/appendices"],
    "Tutorials": [
        f"docs/tutorials/{name}"
        for name in ("identify", "sensor", "floor_plan", "camera", "insertion")
    ],
    "Use": ["docs/parts", "docs/extending", "twin/hardware/README"],
    "Results": [
        "docs/results",
        "docs/shortfalls",
        "docs/benchmarks",
        "docs/performance",
        "docs/mission",
        "docs/own_robot",
        "docs/living_twin",
        "docs/gallery",
    ],
    "Models": [
        f"models/{path.parent.name}/README" for path in sorted(ROOT.glob("models/*/README.md"))
    ],
    "Reference": [f"{REFERENCE}/{name}" for name in PACKAGES],
    "About": ["ARCHITECTURE", "ERRATA", "CONTRIBUTING", "CHANGELOG"],
}
"""Pages of each part of the table of contents, which is put behind the README."""

project = "fieldtwin"
copyright = "Apache-2.0"  # noqa: A001
root_doc = "README"
include_patterns = [
    "*.md",
    "docs/**.md",
    "docs/reference/*.rst",
    "models/*/*.md",
    "twin/hardware/*.md",
]
exclude_patterns = [".venv", "build", "results", "tests", "typings", ".git*", ".ci", "*.egg-info"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
default_role = "py:obj"
toc_object_entries = False

autodoc_member_order = "bysource"
python_maximum_signature_line_length = 90
autodoc_default_options = {
    "members": True,
    "undoc-members": True,
    "ignore-module-all": True,
    "show-inheritance": True,
}
autodoc_preserve_defaults = True

html_theme = "furo"
html_show_search_summary = False  # It fetches the pages, which no browser does from a file.
html_title = "fieldtwin"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"


def _modules(package: Path) -> Iterator[Path]:
    """Yield a package's modules in the order in which its docstring names them."""
    text = (package / "__init__.py").read_text()
    modules = [path for path in package.glob("*.py") if not path.name.startswith("_")]
    yield from sorted(modules, key=lambda path: (text.find(f"`{path.stem}`") % 2**31, path))


def write_reference(app: Any) -> None:
    """Write a page for each package: its docstring, then its modules in reading order."""
    folder = ROOT / REFERENCE
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name in PACKAGES:
        for init in sorted((ROOT / name).rglob("__init__.py")):
            package = init.parent
            title = ".".join(package.relative_to(ROOT).parts)
            inner = sorted(each.parent.name for each in package.glob("*/__init__.py"))
            lines = [title, "=" * len(title), "", f".. automodule:: {title}", ""]
            lines += [".. toctree::", "   :titlesonly:", ""] * bool(inner)
            lines += [f"   {title}.{each}" for each in inner] + [""]
            for module in _modules(package):
                dotted = f"{title}.{module.stem}"
                lines += [dotted, "-" * len(dotted), "", f".. automodule:: {dotted}", ""]
            (folder / f"{title}.rst").write_text("\n".join(lines))


_SECTION = re.compile(r"^Attributes:\n((?:(?: {4}.*)?\n)+)", re.MULTILINE)
_ENTRY = re.compile(r"^ {4}(\w+): (.*\n(?:(?: {5}.*)?\n)*)", re.MULTILINE)
_described: dict[str, list[str]] = {}
"""Descriptions of attributes and constants, by full names."""


def move_attributes(
    app: Any, what: str, name: str, described: Any, options: Any, lines: list[str]
) -> None:
    """Move the "Attributes" of a class to the attributes, which have a type and a value, too."""
    if what in ("attribute", "data"):
        _described.setdefault(name, list(lines))
    text = "\n".join(lines) + "\n"
    section = _SECTION.search(text) if what in ("class", "exception") else None
    if section is None:
        return
    annotated = ModuleAnalyzer.for_module(described.__module__)
    annotated.analyze()
    own = {*vars(described), *inspect.get_annotations(described)}
    own |= {each for kind, each in annotated.annotations if kind == described.__qualname__}

    def move(entry: re.Match[str]) -> str:
        if entry[1] not in own:
            return entry[0]
        _described[f"{name}.{entry[1]}"] = inspect.cleandoc(entry[2]).splitlines()
        return ""

    rest = _ENTRY.sub(move, section[1])
    kept = f"Attributes:\n{rest}" if rest.strip() else ""
    lines[:] = (text[: section.start()] + kept + text[section.end() :]).splitlines()


def mend_markup(
    app: Any, what: str, name: str, described: Any, options: Any, lines: list[str]
) -> None:
    """Undo what is no markup: bars are magnitudes, and no type stands before a colon."""
    if what in ("attribute", "data"):
        lines[:] = _described[name]
    lines[:] = [re.sub(r"(``.*?``)|\|", lambda bar: bar[1] or r"\|", line) for line in lines]


def link_names(app: Any, document: nodes.document) -> None:
    """Let quoted names and files of the documented packages lead to the reference."""
    for quoted in list(document.findall(nodes.literal)):
        name = quoted.astext().removesuffix(".py").replace("/", ".")
        if name.startswith(tuple(f"{each}." for each in PACKAGES)) and _is_plain(quoted):
            link = pending_xref("", refdomain="py", reftype="obj", reftarget=name)
            quoted.replace_self(link)
            link += quoted


def _is_plain(quoted: nodes.literal) -> bool:
    """Return whether a text in quotes is neither a link nor part of one already."""
    return not isinstance(quoted.parent, nodes.reference | pending_xref)


def resolve_exactly(app: Any, document: nodes.document) -> None:
    """Let types be found by their full names alone.

    Sphinx takes a flag that is there and False for True, and compares each type with the ends of
    all names: a third of the time to build, and links from `points` to any of five.
    """
    for reference in document.findall(pending_xref):
        if not reference.get("refspecific", True):
            del reference["refspecific"]


def list_constants(app: Any) -> None:
    """Let autodoc list constants without a docstring, which it takes for imported ones.

    Its description is the comment on its line.
    """
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            dotted = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            analyzer = ModuleAnalyzer.for_module(dotted.removesuffix(".__init__"))
            analyzer.analyze()
            lines = path.read_text().splitlines()
            for statement in ast.parse("\n".join(lines)).body:
                comment = re.findall(r"  # (.*)$", lines[statement.lineno - 1])
                for name in _assigned(statement):
                    if not name.startswith("_"):
                        own = analyzer.attr_docs.setdefault(("", name), comment)
                        _described[f"{analyzer.modname}.{name}"] = own


def _assigned(statement: ast.stmt) -> list[str]:
    """Return the names that a statement of a module assigns to."""
    targets = getattr(statement, "targets", [getattr(statement, "target", None)])
    found = [each for target in targets if target for each in ast.walk(target)]
    return [each.id for each in found if isinstance(each, ast.Name)]


def add_contents(app: Any, page: str, source: list[str]) -> None:
    """Put the table of contents behind the README, which is the first page."""
    if page == root_doc:
        for caption, pages in CONTENTS.items():
            listed = "\n".join(f"/{each}" for each in pages)
            source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n{listed}\n```\n"


def copy_first_page(app: Any, error: Exception | None) -> None:
    """Let the folder open with the README."""
    if error is None:
        shutil.copy(Path(app.outdir) / f"{root_doc}.html", Path(app.outdir) / "index.html")


_MATHML = LatexToMathML()


def _visit_math(self: Any, node: nodes.math) -> None:
    self.body.append(_MATHML.convert_with_local_state(node.astext(), displaystyle=False))
    raise nodes.SkipNode


def _visit_displayed_math(self: Any, node: nodes.math_block) -> None:
    equation = _MATHML.convert_with_local_state(node.astext(), displaystyle=True)
    self.body.append(f'<div class="equation">{equation}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Register all of the above."""
    app.add_html_math_renderer("mathml", (_visit_math, None), (_visit_displayed_math, None))
    app.connect("builder-inited", write_reference)
    app.connect("builder-inited", list_constants)
    app.connect("source-read", add_contents)
    app.connect("build-finished", copy_first_page)
    app.connect("doctree-read", link_names)
    app.connect("doctree-read", resolve_exactly)
    app.connect("autodoc-process-docstring", move_attributes, priority=400)  # before Napoleon
    app.connect("autodoc-process-docstring", mend_markup, priority=600)  # after it
