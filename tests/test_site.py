"""The site that `make docs` builds: complete, whole, light, and quiet without network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import site_pages
from tests.experiments import browser

ROOT = Path(__file__).parent.parent
PACKAGES = ("twin", "perception", "controllers")
HEAVIEST = 3_000_000  # [bytes]
pytestmark = pytest.mark.timeout(900)  # The site is built in the first of them that needs it.


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as `make docs` does; a warning would fail it."""
    folder = tmp_path_factory.mktemp("site")
    (recipe,) = re.findall(r"^docs:.*\n\t\$\(BIN\)/python (-m sphinx .*)$", MAKEFILE, re.MULTILINE)
    words = recipe.replace("build/", f"{folder}/").split()
    result = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return folder / "site"


MAKEFILE = (ROOT / "Makefile").read_text()


@pytest.fixture(scope="module")
def pages(site):
    return site_pages.read(site)


@pytest.mark.slow
def test_no_link_is_broken(pages):
    assert len(pages) >= 70  # noqa: PLR2004
    assert site_pages.broken_links(pages) == []


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(pages):
    assert site_pages.loaded_from_outside(pages) == []


@pytest.mark.slow
def test_no_page_weighs_more_than_three_megabytes(site, pages):
    heavy = {str(path.relative_to(site)): site_pages.weight(page) for path, page in pages.items()}
    assert {name: size for name, size in heavy.items() if size > HEAVIEST} == {}
    assert heavy["README.html"] > (ROOT / "docs" / "mission.gif").stat().st_size


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_in_the_reference(site, package):
    wanted = site_pages.public_names(ROOT, package)
    assert len(wanted) > 500  # noqa: PLR2004
    assert sorted(wanted - site_pages.inventory(site / "objects.inv")) == []


@pytest.mark.slow
def test_what_a_function_returns_is_taken_for_no_type(site):
    """Napoleon takes for a type what stands before a colon in the first line of "Returns"."""
    folder = site / "docs" / "reference"
    wrong = [path.name for path in folder.glob("*.html") if "Return type" in path.read_text()]
    assert wrong == []


@pytest.mark.slow
@pytest.mark.skipif(browser.PATH is None, reason="no chromium here: apt install chromium")
def test_a_browser_without_network_reports_no_error(site, pages, tmp_path):
    with browser.Browser(tmp_path) as chromium:
        chromium.call(
            "Network.emulateNetworkConditions",
            offline=True, latency=0, downloadThroughput=0, uploadThroughput=0,
        )  # fmt: skip
        for path in pages:
            chromium.show(f"file://{path}", 1280)
        chromium.show(f"file://{site}/search.html?q=DeferredImages", 390)
        found = chromium.evaluate(
            "new Promise(done => { const look = () => document.querySelector('ul.search li a')"
            " ? done(document.querySelector('ul.search').textContent) : setTimeout(look, 50);"
            " look(); })"
        )
        assert "twin.robot.DeferredImages" in found
        assert noise(chromium.events) == []
        width = chromium.evaluate("document.documentElement.scrollWidth")
        assert width <= 390  # noqa: PLR2004


def noise(events):
    """Return what a browser reported that it should not have: errors, and requests to a host."""
    heard = []
    for name, report in events:
        if name == "Log.entryAdded" and report["entry"]["level"] in ("error", "warning"):
            heard.append(report["entry"]["text"])
        elif name == "Runtime.exceptionThrown":
            heard.append(report["exceptionDetails"]["text"])
        elif name == "Runtime.consoleAPICalled" and report["type"] in ("error", "assert"):
            heard.append(str(report["args"]))
        elif name == "Network.requestWillBeSent":
            address = report["request"]["url"]
            if not address.startswith(("file:", "data:", "about:")):
                heard.append(address)
    return heard


def test_a_broken_link_is_seen(tmp_path):
    (tmp_path / "one.html").write_text(
        '<a href="two.html#here">1</a><a href="two.html#gone">2</a><a href="three.html">3</a>'
        '<a href="http://example.com/">4</a><img src="no.png"><p id="top"></p><a href="#top">5</a>'
    )
    (tmp_path / "two.html").write_text('<p id="here"></p>')
    broken = site_pages.broken_links(site_pages.read(tmp_path))
    assert sorted(broken) == [
        "one.html: no.png",
        "one.html: three.html",
        "one.html: two.html#gone",
    ]


def test_a_load_from_elsewhere_is_seen(tmp_path):
    (tmp_path / "own.css").write_text("@import 'https://a.test/x.css'; p{background:url(own.png)}")
    (tmp_path / "page.html").write_text(
        '<link rel="stylesheet" href="own.css"><script src="//b.test/x.js"></script>'
        '<img src="data:image/png;base64,"><a href="https://c.test/">a link</a>'
        '<style>p { background: url("http://d.test/x.png") }</style>'
    )
    outer = site_pages.loaded_from_outside(site_pages.read(tmp_path))
    assert sorted(outer) == [
        "own.css: https://a.test/x.css",
        "page.html: //b.test/x.js",
        "page.html: http://d.test/x.png",
    ]


def test_a_page_weighs_what_it_loads(tmp_path):
    (tmp_path / "page.html").write_text('<img src="a.png"><img src="a.png"><a href="b.png">b</a>')
    (tmp_path / "a.png").write_bytes(bytes(1000))
    (tmp_path / "b.png").write_bytes(bytes(5000))
    (page,) = site_pages.read(tmp_path).values()
    assert site_pages.weight(page) == 1000 + page.path.stat().st_size


def test_public_names_are_those_of_the_source(tmp_path):
    folder = tmp_path / "part"
    folder.mkdir()
    (folder / "__init__.py").write_text("from part.inner import Thing\nLIMIT = 1\n")
    (folder / "inner.py").write_text(
        "A, _B = range(2)\ndef act(): ...\ndef _hide(): ...\n"
        "class Thing:\n    size: int\n    def grow(self): ...\n    def _shrink(self): ...\n"
    )
    assert site_pages.public_names(tmp_path, "part") == {
        "part", "part.LIMIT", "part.inner", "part.inner.A", "part.inner.act", "part.inner.Thing",
        "part.inner.Thing.size", "part.inner.Thing.grow",
    }  # fmt: skip
