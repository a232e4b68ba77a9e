"""The report of the quick runs that the tests have kept; `tools/run_tests.sh` runs this file."""

from pathlib import Path

import pytest

from experiments.report.report import write_report
from experiments.report.results import read_results
from tests.experiments import browser
from tests.experiments.report.browser_report import sound_pictures

LIMIT = 20_000_000  # [bytes]


@pytest.fixture
def kept(request):
    return Path(request.config.getoption("--keep-results")).resolve()


def test_report_contains_every_result_and_is_small_enough_to_send(kept):
    names = [result.name for result in read_results(kept)]
    path = write_report(kept)
    text = path.read_text()
    assert all(f'<section id="{name}">' in text for name in names)
    assert path.stat().st_size < LIMIT
    print(f"{path.name}: {len(names)} experiments, {path.stat().st_size / 1e6:.1f} MB")


@pytest.mark.skipif(browser.PATH is None, reason="no Chromium; `make test` installs it by apt")
@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_finds_nothing_broken_in_it(kept, tmp_path, width):
    shown = sound_pictures(write_report(kept), width, tmp_path / "profile")
    assert shown >= sum(len(result.figures) > 0 for result in read_results(kept))
