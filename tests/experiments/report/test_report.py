import json
import re

import pytest
from PIL import Image

from experiments.__main__ import main
from experiments.harness.contract import ExperimentError
from experiments.harness.thesis_elements import Reason
from experiments.report.findings import agrees, differences
from experiments.report.html import command, plain_key
from experiments.report.images import WIDTH, embed
from experiments.report.report import write_report
from experiments.report.results import read_result
from tests.experiments import browser
from tests.experiments.harness.tiny import CATALOGUE
from tests.experiments.report.browser_report import sound_pictures
from tests.hostile_files import png_of_zeros


def test_report_begins_with_what_was_found_and_what_falls_short_and_holds_everything(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    assert main(["report", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text()
    found, short = text.index("What was found</h2>"), text.index("What falls short: 1 of 2 checks")
    assert found < short < text.index('<section id="tiny">')
    assert "1 of 2 checks hold." in text[found:short] and "thesis 18.9" in text[found:short]
    assert text[found:short].count('<img alt=""') == 1
    for part in ("18.9", "error is small", "table 2-1", "mass [kg]", "mujoco version"):
        assert part in text
    assert "python -m experiments tiny</code>" in text
    assert text.count('<img alt="figure 2-4"') == 1
    assert "ours &amp; &lt;theirs&gt;" in text
    assert str(tmp_path) not in text
    assert "<script" not in text
    places = re.findall(r'(?:src|href)="([^"]{1,5})', text)
    assert places and all(place.startswith(("#", "data:")) for place in places)


def test_a_quick_run_is_shown_and_not_judged(tmp_path):
    assert main(["tiny", "--out", str(tmp_path), "--quick"], CATALOGUE) == 0
    text = write_report(tmp_path).read_text()
    assert "A quick run: not judged." in text and "python -m experiments tiny --quick" in text
    assert "error is small" in text and "18.9" in text
    for red in ('class="short"', "falls short", "What differs", 'class="fail"', "class='fail'"):
        assert red not in text


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("avg_error_percent/constant/ours", "avg error [%], constant, ours"),
        ("sag_mm/5/no_head", "sag [mm], 5, no head"),
        ("contact_force_n", "contact force [N]"),
        ("success_fraction", "success [-]"),
        ("rank", "rank"),
        ("m", "m"),
        ("first_first", "first first"),
    ],
)
def test_metrics_are_named_in_words_with_their_unit(key, words):
    assert plain_key(key) == words


def test_report_of_nothing_is_refused(tmp_path, capsys):
    assert main(["report", "--out", str(tmp_path)]) == 1
    assert "run an experiment first" in capsys.readouterr().err


def test_damaged_result_is_named(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    (tmp_path / "tiny" / "metrics.json").write_text("{")
    with pytest.raises(ExperimentError, match=r"metrics\.json: cannot be read"):
        write_report(tmp_path)


def test_a_changed_digit_is_noticed_and_runs_without_a_digest_are_taken(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    metrics, run = tmp_path / "tiny" / "metrics.json", tmp_path / "tiny" / "run.json"
    metrics.write_text(metrics.read_text().replace("12.5", "13.5"))
    with pytest.raises(ExperimentError, match=r"metrics\.json: not as its run has written it"):
        write_report(tmp_path)
    contents = json.loads(run.read_text())
    del contents["metrics_sha256"]
    run.write_text(json.dumps(contents))
    assert "13.5" in write_report(tmp_path).read_text()


@pytest.mark.parametrize("name", ["figures/figure_2-4.png", "tables/table_2-1.csv"])
def test_damaged_picture_or_table_is_named(tmp_path, name):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    (tmp_path / "tiny" / name).write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(ExperimentError, match=name):
        write_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


HOSTILE = {
    "metrics.json": (b"[" * 10**6, r"metrics\.json: cannot be read \(nested too deeply"),
    "run.json": (b" " * (2**24 + 1), r"run\.json: .*16,777,217 bytes, the limit is 16,777,216"),
    "tables/table_2-1.csv": (b"," * (2**24 + 1), r"table_2-1\.csv: .*the limit is 16,777,216"),
    "figures/figure_2-4.png": (png_of_zeros(12_000, 12_000), r"figure_2-4\.png: .*144,000,000"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_result_that_is_larger_than_any_is_named(tmp_path, name):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    content, reason = HOSTILE[name]
    (tmp_path / "tiny" / name).write_bytes(content)
    with pytest.raises(ExperimentError, match=reason):
        write_report(tmp_path)


def test_picture_damaged_behind_its_header_is_named(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    path = tmp_path / "tiny" / "figures" / "figure_2-4.png"
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole.replace(b"IDAT", b"IDA\0", 1)):
        path.write_bytes(damaged)
        with pytest.raises(ExperimentError, match=r"figure_2-4\.png: no picture"):
            write_report(tmp_path)


def test_report_that_cannot_be_written_is_one_line(tmp_path, capsys):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    (tmp_path / "report.html").mkdir()
    assert main(["report", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'report.html'}: Is a directory\n"


def test_pictures_of_the_thesis_are_found_from_its_elements(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    (tmp_path / "tiny").rename(tmp_path / "ch2-simulation")
    text = write_report(tmp_path).read_text()
    for place in ("ch2-simulation/figure_2-4", "ch2-simulation/table_2-1"):
        assert text.count(f'<a href="#{place}">') == 1
        assert text.count(f' id="{place}"') == 1
    assert "Figure 2-4: constant arm motion</figcaption>" in text
    assert "<td>not run: <code>python -m experiments ch3-planar</code></td>" in text
    assert '<td>not in this run of <a href="#ch2-simulation">' in text
    assert "2 of 67 shown" in text


def test_a_figure_agrees_if_the_thesis_lies_in_its_interval_or_within_a_hundredth():
    assert agrees({"low": 1.0, "high": 2.0}, 1.5)
    assert agrees({"low": 1.0, "high": 2.0}, 2.01)
    assert not agrees({"low": 1.0, "high": 2.0}, 2.1)
    assert agrees(99.0, 100.0) and not agrees(98.0, 100.0)
    assert agrees("primary", "primary") and not agrees(None, 3.0)
    assert not agrees({"low": None, "high": 2.0}, 1.0)


def test_differences_are_grouped_by_their_reason(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    result = read_result(tmp_path / "tiny")
    known = [Reason("tiny", ("error_*",), "The wheel was < round.")]
    for reasons, text in ((known, "The wheel was &lt; round."), ([], "The cause is not known.")):
        html = differences([result], reasons)
        assert "1 of 1 figures" in html and text in html and "18.9" in html


def test_the_command_leaves_out_where_and_on_how_many_cores(tmp_path):
    words = ["tiny", "--out", str(tmp_path), "--jobs=3", "--seed", "4", "--resume"]
    assert main(words, CATALOGUE) == 0
    run = json.loads((tmp_path / "tiny" / "run.json").read_text())
    assert run["command"] == words
    result = read_result(tmp_path / "tiny")
    assert command(result) == "python -m experiments tiny --seed 4"
    del result.run["command"]
    assert command(result) == "python -m experiments tiny --seed 4"


def test_wide_pictures_are_reduced_and_small_ones_kept(tmp_path):
    wide, tiny = tmp_path / "wide.png", tmp_path / "tiny.png"
    Image.effect_noise((2 * WIDTH, 300), 60).save(wide)
    Image.new("RGB", (3, 2)).save(tiny)
    picture = embed(wide)
    assert (picture.width, picture.height) == (WIDTH, 150)
    assert len(picture.url) < wide.stat().st_size
    assert (embed(tiny).width, embed(tiny).height) == (3, 2)


@pytest.mark.slow
@pytest.mark.skipif(browser.PATH is None, reason="no Chromium; `make test` installs it by apt")
@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_finds_nothing_broken_and_nothing_outside(tmp_path, width):
    assert main(["tiny", "--out", str(tmp_path / "results")], CATALOGUE) == 0
    (tmp_path / "results" / "tiny").rename(tmp_path / "results" / "ch2-simulation")
    path = write_report(tmp_path / "results")
    assert "<details><summary>" in path.read_text()  # Folded on the screen.
    assert sound_pictures(path, width, tmp_path / "profile") == 2


@pytest.mark.slow
@pytest.mark.skipif(browser.PATH is None, reason="no Chromium; `make test` installs it by apt")
def test_the_browser_does_tell_of_broken_pages(tmp_path):
    page = tmp_path / "page.html"
    page.write_text(
        '<img src="data:image/png;base64,AAAA"><img src="http://127.0.0.1:9/x.png">'
        "<script>wheel()</script>"
    )
    with browser.Browser(tmp_path / "profile") as chromium:
        chromium.show(page.as_uri(), 390)
        assert chromium.evaluate("document.images[0].naturalWidth") == 0
        names = [name for name, _ in chromium.events]
        asked = [event["request"]["url"] for _, event in chromium.events if "request" in event]
    assert "Runtime.exceptionThrown" in names and "Log.entryAdded" in names
    assert "http://127.0.0.1:9/x.png" in asked
