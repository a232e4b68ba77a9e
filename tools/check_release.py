"""Check that what is committed can be released under its version; run by ``make release``."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
_SECTION = re.compile(r"^## \[(.+?)\](.*)$", re.MULTILINE)


def problems(root: Path) -> list[str]:
    """Return what stands against a release, a line each.

    Args:
        root: Checkout to be released.
    """
    found = []
    status = ["git", "status", "--porcelain"]
    if changed := subprocess.check_output(status, cwd=root, text=True).splitlines():
        found.append(
            f"the tree is not clean: commit or remove {changed[0][3:]} ({len(changed)} in all)"
        )
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    version = project["version"]
    cited = re.search(r"^version: (.+)$", (root / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    if cited is not None and cited[1].strip("\"' ") != version:
        found.append(f"CITATION.cff has version {cited[1]}, pyproject.toml {version}")
    return found + _problems_of_changelog((root / "CHANGELOG.md").read_text("utf-8"), version)


def _problems_of_changelog(text: str, version: str) -> list[str]:
    parts = _SECTION.split(text)[1:]
    sections = list(zip(parts[::3], parts[1::3], parts[2::3]))
    found = []
    if sections and sections[0][0] == "Unreleased":
        if sections.pop(0)[2].strip():
            found.append(f"CHANGELOG.md: move what is [Unreleased] to a section [{version}] - DATE")
    name, date, _ = sections[0] if sections else ("none", "", "")
    if name != version:
        found.append(f"CHANGELOG.md: newest section is {name}, pyproject.toml has {version}")
    elif not re.fullmatch(r" - \d{4}-\d\d-\d\d", date):
        found.append(f"CHANGELOG.md: section {version} has no date as [{version}] - 2026-01-31")
    return found


def main() -> int:
    """Print what stands against a release; return 1 if anything does."""
    found = problems(ROOT)
    for line in found:
        print(f"release: {line}", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
