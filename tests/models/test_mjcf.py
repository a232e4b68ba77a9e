"""Robots of a user's own, whose files want more memory than there is."""

import pytest

from models.compose import load_robot
from tests.hostile_files import png_of_zeros, run_and_weigh

CHASSIS = '<worldbody><body name="chassis"><freejoint/><geom size="1"/></body></worldbody>'
LAUGHS = "".join(f'<!ENTITY lol{k} "{f"&lol{k - 1};" * 10}">' for k in range(1, 10))
HOSTILE = {
    "a height field": (
        '<asset><hfield name="f" nrow="6000" ncol="6000" size="1 1 1 1"/></asset>',
        "robot.xml: hfield f",
    ),
    "a drawn texture": (
        '<asset><texture name="t" builtin="flat" type="2d" width="30000" height="30000"/></asset>',
        "robot.xml: texture t",
    ),
    "six faces of a texture": (
        '<asset><texture name="t" builtin="flat" type="cube" width="4000" height="4000"/></asset>',
        "96,000,000 pixels",
    ),
    "a picture": (
        '<compiler texturedir="p"/><asset><texture name="t" type="2d" file="bomb.png"/></asset>',
        "144,000,000 pixels",
    ),
    "a picture of a cube": (
        '<compiler texturedir="p"/><asset><texture name="t" fileup="bomb.png"/></asset>',
        "144,000,000 pixels",
    ),
    "a height field's picture": (
        '<compiler meshdir="p"/><asset><hfield name="f" file="bomb.png" size="1 1 1 1"/></asset>',
        "144,000,000 pixels",
    ),
    "a mesh": (
        '<compiler meshdir="p"/><asset><mesh name="m" file="huge.obj"/></asset>',
        "huge.obj",
    ),
    "nesting": ("<worldbody>" + "<body>" * 10**5, "nesting is too deep"),
    "half a file": ("<asset>", "XML"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    (folder / "p").mkdir()
    (folder / "p" / "bomb.png").write_bytes(png_of_zeros(12_000, 12_000))
    with (folder / "p" / "huge.obj").open("wb") as stream:
        stream.truncate(2**26 + 1)  # Takes no place on the disk.
    return folder


@pytest.mark.parametrize("what", HOSTILE)
def test_robot_that_needs_too_much_is_refused_before_it_is_compiled(what, folder):
    text, reason = HOSTILE[what]
    path = folder / "robot.xml"
    path.write_text(f"<mujoco>{text}{CHASSIS}</mujoco>")
    with pytest.raises(ValueError, match=reason) as caught:
        load_robot(str(path))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_mjcf_of_many_bytes_is_refused(tmp_path):
    path = tmp_path / "robot.xml"
    with path.open("wb") as stream:
        stream.truncate(2**26 + 1)
    with pytest.raises(ValueError, match="67,108,865 bytes, the limit is 67,108,864"):
        load_robot(str(path))


def test_entities_of_entities_take_no_memory(tmp_path):
    """MuJoCo leaves them as they are: ten to the ninth power of "lol" is not written out."""
    path = tmp_path / "robot.xml"
    path.write_text(
        f'<!DOCTYPE l [<!ENTITY lol0 "lol">{LAUGHS}]><mujoco model="&lol9;">{CHASSIS}</mujoco>'
    )
    _, grown = run_and_weigh("from models.compose import load_robot", f"load_robot({str(path)!r})")
    assert grown < 50.0
