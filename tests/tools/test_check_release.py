"""Nothing is released from a tree that is not clean, or under two versions."""

import subprocess

import pytest

from tools.check_release import ROOT, problems

FILES = {
    "pyproject.toml": '[project]\nname = "x"\nversion = "0.9.0"\n',
    "CITATION.cff": "cff-version: 1.2.0\nversion: 0.9.0\n",
    "CHANGELOG.md": "# Changelog\n\n## [Unreleased]\n\n## [0.9.0] - 2026-01-31\n\n- All.\n",
}


def git(folder, *words):
    identity = ["-c", "user.name=tester", "-c", "user.email=tester@example.invalid"]
    subprocess.run(["git", *identity, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path):
    """Return a clean tree that can be released."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    git(tmp_path, "init")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "All")
    return tmp_path


def test_a_clean_tree_of_one_version_can_be_released(checkout):
    assert problems(checkout) == []


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [
        ("pyproject.toml", "0.9.0", "0.9.1", "newest section is 0.9.0, pyproject.toml has 0.9.1"),
        ("CITATION.cff", "0.9.0", "0.8.0", "CITATION.cff has version 0.8.0, pyproject.toml 0.9.0"),
        ("CHANGELOG.md", "[0.9.0]", "[0.8.0]", "newest section is 0.8.0"),
        ("CHANGELOG.md", " - 2026-01-31", "", "section 0.9.0 has no date"),
        ("CHANGELOG.md", "sed]\n", "sed]\n\n- New.\n", "move what is [Unreleased] to a section"),
        ("CHANGELOG.md", "## [0.9.0] - 2026-01-31", "", "newest section is none"),
    ],
)
def test_what_stands_against_a_release_is_named(checkout, name, old, new, reason):
    path = checkout / name
    path.write_text(path.read_text().replace(old, new))
    git(checkout, "commit", "-a", "-m", "Change")
    assert any(reason in line for line in problems(checkout))


def test_a_tree_that_is_not_clean_is_refused(checkout):
    (checkout / "new.py").write_text("")
    (line,) = problems(checkout)
    assert "not clean" in line and "new.py" in line


def test_a_citation_without_a_version_says_nothing_against_it(checkout):
    (checkout / "CITATION.cff").write_text("cff-version: 1.2.0\n")
    git(checkout, "commit", "-a", "-m", "Change")
    assert problems(checkout) == []


def test_version_and_licence_are_cited_as_they_are_packaged():
    against = "CITATION.cff"
    assert [line for line in problems(ROOT) if against in line] == []
