"""Which tests need the machine for themselves."""

from __future__ import annotations

from pathlib import Path

import pytest

HARDWARE = Path(__file__).parent / "twin" / "hardware"


def pytest_addoption(parser):
    parser.addoption(
        "--real-time",
        choices=("only", "skip"),
        help="run only, or leave out, tests that time something or wait for a clock",
    )


def pytest_collection_modifyitems(config, items):
    for item in items:
        # Boards answer from another process, within deadlines of milliseconds.
        if HARDWARE in item.path.parents:
            item.add_marker(pytest.mark.real_time)
    wanted = config.getoption("--real-time")
    if wanted is None:
        return
    chosen, left_out = [], []
    for item in items:
        real_time = item.get_closest_marker("real_time") is not None
        (chosen if real_time == (wanted == "only") else left_out).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = chosen
