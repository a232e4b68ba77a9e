"""The import rule, read from the syntax trees."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = {"models", "twin", "perception", "controllers", "experiments", "tests"}
ALLOWED = {
    "models": set(),
    "twin": {"models"},
    "perception": set(),
    "controllers": {"perception"},
    "experiments": {"models", "twin", "perception", "controllers"},
}
# What a controller could reach the truth by.
FORBIDDEN_IN_CONTROLLERS = {
    "mujoco",
    "dm_control",
    "gc",
    "inspect",
    "importlib",
    "ctypes",
    "__main__",
}
TYPES_FOR_CONTROLLERS = ("twin.robot", "twin.description", "twin.link")
FOR_ALL = "perception.geometry"
"""Lies below all rooms: every folder may import it."""


def imports(path: Path) -> list[tuple[int, str]]:
    """Line and dotted name of everything that a file imports, as absolute names."""
    package = path.relative_to(ROOT).with_suffix("").parts
    found = []
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level]) if node.level else ""
            name = ".".join(part for part in (base, node.module or "") if part)
            found += [(node.lineno, f"{name}.{alias.name}") for alias in node.names]
    return found


def violations(path: Path, house: str) -> list[str]:
    wrong = []
    for line, name in imports(path):
        first = name.split(".")[0]
        if first in OURS - {house} - ALLOWED[house]:
            if f"{name}.".startswith(f"{FOR_ALL}."):
                continue
            if house == "controllers" and any(
                f"{name}.".startswith(f"{room}.") for room in TYPES_FOR_CONTROLLERS
            ):
                continue
            wrong.append(f"{path.relative_to(ROOT)}:{line} imports {name}")
        if house == "controllers" and first in FORBIDDEN_IN_CONTROLLERS:
            wrong.append(f"{path.relative_to(ROOT)}:{line} imports {name}")
    return wrong


@pytest.mark.parametrize("house", ALLOWED)
def test_folder_imports_only_what_the_rule_allows(house):
    files = sorted((ROOT / house).rglob("*.py"))
    assert files
    assert [line for path in files for line in violations(path, house)] == []


def test_controllers_do_not_look_behind_the_stage():
    """No frame walking, no dynamic import: with the import rule this closes the truth barrier."""
    names = {
        "_getframe",
        "__import__",
        "import_module",
        "__subclasses__",
        "__globals__",
        "eval",
        "exec",
        "modules",
    }
    wrong = []
    for path in sorted((ROOT / "controllers").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(), str(path))):
            name = node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", None)
            if name in names:
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno} uses {name}")
    assert wrong == []


def test_rule_is_broken_by_what_it_forbids(tmp_path, monkeypatch):
    """The check itself sees every form of import."""
    monkeypatch.setattr("tests.test_architecture.ROOT", tmp_path)
    folder = tmp_path / "controllers" / "deep"
    folder.mkdir(parents=True)
    bad = folder / "bad.py"
    bad.write_text(
        "import mujoco\nfrom twin import simulation\nfrom models.compose import FLAT\n"
        "from twin.robot import Command\nfrom twin import robot\nfrom perception import stereo\n"
        "def late():\n    import twin.simulation\n    from ...twin import record\n"
    )
    lines = [int(line.split(":")[1].split()[0]) for line in violations(bad, "controllers")]
    assert lines == [1, 2, 3, 8, 9]


def test_nothing_that_steps_on_observations_lives_in_experiments():
    """What decides what a robot does is a controller."""
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sorted((ROOT / "experiments").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(), str(path)))
        if isinstance(node, ast.FunctionDef)
        and node.name == "step"
        and any(argument.arg == "observations" for argument in node.args.args)
    ]
    assert found == []


def _files(house: str) -> dict[str, Path]:
    """Dotted names of a folder's modules."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for path in sorted((ROOT / house).rglob("*.py"))
        if path.name != "__init__.py"
    }


LAYERS = (
    {"kinematics"},
    {"identification", "braid"},
    {"motion"},
    {"sensing"},
    {"mapping"},
    {"placement"},
    {"insertion"},
    {"mission"},
)
"""Rooms of the controllers from below."""


def test_no_arrow_runs_up_between_the_rooms_of_the_controllers():
    rank = {room: level for level, rooms in enumerate(LAYERS) for room in rooms}
    upward = []
    for name, path in _files("controllers").items():
        own = rank[name.split(".")[1]]
        for line, target in imports(path):
            parts = target.split(".")
            if parts[0] == "controllers" and rank.get(parts[1], 0) > own:
                upward.append(f"{name}:{line} imports {target}")
    assert upward == []


STILL_CIRCLING = ("experiments.harness.", "experiments.report.")


def test_no_files_import_each_other_in_a_circle():
    files = {name: path for house in ALLOWED for name, path in _files(house).items()}
    arrows = {name: {_file_of(target, files) for _, target in imports(path)} - {"", name}
              for name, path in files.items()}  # fmt: skip
    pending = dict(arrows)
    # Take away, again and again, what imports nothing that is left, and what nothing left imports.
    while free := [
        name
        for name in pending
        if not arrows[name] & pending.keys() or not any(name in arrows[other] for other in pending)
    ]:
        for name in free:
            del pending[name]
    # Still in a circle: contract and output of the harness, the report and its pages.
    assert [name for name in sorted(pending) if not name.startswith(STILL_CIRCLING)] == []


def _file_of(target: str, files: dict[str, Path]) -> str:
    """Name of the module that an imported name comes from; empty if it is none of ours."""
    while target and target not in files:
        target = target.rpartition(".")[0]
    return target


MOST_MODULES = 16


def test_a_folder_holds_at_most_sixteen_modules():
    crowded = {}
    for house in ALLOWED:
        for folder in [ROOT / house, *(p for p in (ROOT / house).rglob("*") if p.is_dir())]:
            count = len([path for path in folder.glob("*.py") if path.name != "__init__.py"])
            if count > MOST_MODULES:
                crowded[str(folder.relative_to(ROOT))] = count
    assert crowded == {}
