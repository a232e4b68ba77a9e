"""Pages of a built site, read by the standard library: what they link to, load and weigh."""

import ast
import dataclasses
import html.parser
import re
import zlib
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"src", "srcset", "poster", "data"}
"""Attributes by which a tag loads something; a link does by `href`, unless it only names a page."""
NAMES_A_PAGE = {"index", "search", "next", "prev", "author", "copyright", "canonical", "license"}
URL = re.compile(r"""(?:url\(\s*["']?|@import\s+["'])([^"')]+)""")


@dataclasses.dataclass
class Page(html.parser.HTMLParser):
    """One page.

    Attributes:
        path: Its file.
        links: Targets of its hyperlinks.
        loads: Addresses of all that a browser loads to show it.
        anchors: Names that hyperlinks can lead to.
    """

    path: Path
    links: set = dataclasses.field(default_factory=set)
    loads: set = dataclasses.field(default_factory=set)
    anchors: set = dataclasses.field(default_factory=set)

    def __post_init__(self):
        super().__init__()
        self._in_style = False
        self.feed(self.path.read_text())

    __hash__ = object.__hash__

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.anchors |= {named[key] for key in ("id", "name") if named.get(key)}
        self.loads |= {value.split()[0] for key, value in attrs if key in LOADED and value}
        self.loads |= set(URL.findall(named.get("style") or ""))
        if tag == "link" and named.get("rel") not in NAMES_A_PAGE:
            self.loads.add(named["href"])
        elif "href" in named:
            self.links.add(named["href"])
        self._in_style = tag == "style"

    def handle_data(self, data):
        if self._in_style:
            self.loads |= set(URL.findall(data))

    def file_of(self, address):
        """Return the file that an address of this page leads to."""
        path = unquote(urlsplit(address).path)
        return (self.path.parent / path).resolve() if path else self.path.resolve()


def read(site):
    """Return the pages of a site by file."""
    return {path.resolve(): Page(path) for path in sorted(site.rglob("*.html"))}


def broken_links(pages):
    """Return links and loads that lead to no file, and links that lead to no place on a page."""
    broken = []
    for page in pages.values():
        for address in page.links | page.loads:
            if is_outer(address):
                continue
            target, anchor = page.file_of(address), unquote(urlsplit(address).fragment)
            there = target.is_file()
            if there and anchor and address in page.links and target in pages:
                there = anchor in pages[target].anchors
            if not there:
                broken.append(f"{page.path.name}: {address}")
    return broken


def is_outer(address):
    """Return whether an address is not one of the site's own files."""
    return urlsplit(address).scheme != "" or address.startswith("//")


def loaded_from_outside(pages):
    """Return what pages and their style sheets load from elsewhere."""
    outer = []
    for page in pages.values():
        outer += [f"{page.path.name}: {each}" for each in page.loads if _is_remote(each)]
        for sheet in page.loads:
            if urlsplit(sheet).path.endswith(".css") and not is_outer(sheet):
                inner = URL.findall(page.file_of(sheet).read_text())
                outer += [f"{sheet}: {each}" for each in inner if _is_remote(each)]
    return outer


def _is_remote(address):
    return is_outer(address) and urlsplit(address).scheme != "data"


def weight(page):
    """Return the bytes of a page and of all that it loads."""
    files = {page.path, *(page.file_of(each) for each in page.loads if not is_outer(each))}
    return sum(path.stat().st_size for path in files)


def inventory(path):
    """Return the names in an `objects.inv`, version 2: four lines of text, then zlib."""
    *_, packed = path.read_bytes().split(b"\n", 4)
    return {line.split(" ", 1)[0] for line in zlib.decompress(packed).decode().splitlines()}


def public_names(root, package):
    """Return the dotted names of all that a package's source files define in public."""
    names = set()
    for path in sorted((root / package).rglob("*.py")):
        parts = list(path.relative_to(root).with_suffix("").parts)
        if parts[-1] == "__init__":
            parts.pop()
        if not any(part.startswith("_") for part in parts):
            module = ".".join(parts)
            names |= {module, *_defined(ast.parse(path.read_text()), module)}
    return names


def _defined(scope, prefix):
    """Yield the dotted public names that a module or a class defines."""
    for node in scope.body:
        found = []
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found = [node.name]
        elif isinstance(node, ast.Assign):
            found = [each.id for target in node.targets for each in _plain(target)]
        elif isinstance(node, ast.AnnAssign):
            found = [each.id for each in _plain(node.target)]
        for name in found:
            if not name.startswith("_"):
                yield f"{prefix}.{name}"
                if isinstance(node, ast.ClassDef):
                    yield from _defined(node, f"{prefix}.{name}")


def _plain(target):
    """Return the bare names that are assigned to."""
    return [each for each in ast.walk(target) if isinstance(each, ast.Name)]
