"""Write the MJCF files of what is built in Python: ``python -m models.write_scenes``.

Each model's ``scene.xml``, which any MuJoCo viewer opens, adds floor and light to the model's own
file. Those of the field and of BRAID are written here as a whole.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import mujoco
import numpy as np

from models.braid.build import BraidConfig
from models.braid.build import build_bench as build_braid_bench
from models.card_and_slot.build import build_bench
from models.card_and_slot.guides import build_guides_bench
from models.compose import FOLDER, ROUGH, RobotPlacement, build_scene
from models.datasheets import CARD_AND_SLOT, CARD_GUIDE

PICTURE = "ground.png"
"""The ground's texture, which MJCF cannot hold itself."""
_COMMENT = "Written by python -m models.write_scenes from what {source} builds."
GROUND = dataclasses.replace(ROUGH, size=(3.0, 3.0), rocks=ROUGH.rocks // 4, texture_pixels=256)
"""As rough as `ROUGH`, on a quarter of its area, and in a texture that one small picture holds."""


def field() -> mujoco.MjSpec:
    """Return rough ground with a rover, whose textures are `PICTURE`."""
    scene = build_scene(GROUND, [RobotPlacement()])
    ground = scene.texture("ground")
    shape = (ground.height, ground.width, ground.nchannel)
    image = np.frombuffer(bytes(ground.data), np.uint8).reshape(shape)
    _, encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    scene.assets = {PICTURE: encoded.tobytes()}
    for texture in scene.textures:
        if texture.data:
            texture.data, texture.file = b"", PICTURE
            texture.width = texture.height = 0
    return scene


def braid() -> mujoco.MjSpec:
    """Return BRAID of five stages with the stereo head, on a table."""
    return build_braid_bench(BraidConfig())


def card_and_slot() -> mujoco.MjSpec:
    """Return the card before the slot of middle width."""
    return build_bench(CARD_AND_SLOT.slot_widths[1])


def guides() -> mujoco.MjSpec:
    """Return the card before card guides of middle clearance."""
    return build_guides_bench(CARD_GUIDE.clearances[1])


WRITTEN: Mapping[str, tuple[Callable[[], mujoco.MjSpec], str]] = {
    "field/scene.xml": (field, "compose.py"),
    "braid/scene.xml": (braid, "build.py"),
    "card_and_slot/card_and_slot.xml": (card_and_slot, "build.py"),
    "card_and_slot/guides.xml": (guides, "guides.py"),
}
"""What each file is written from: a function, and the file that holds its numbers."""


def write(folder: Path = FOLDER) -> None:
    """Write all files, and the picture that one of them names.

    Args:
        folder: Folder of the models.
    """
    for name, (build, source) in WRITTEN.items():
        spec = build()
        spec.comment = _COMMENT.format(source=source)
        spec.compile()
        path = folder / name
        path.write_text(spec.to_xml(), encoding="utf-8")
        for picture, content in spec.assets.items():
            path.with_name(picture).write_bytes(content)
        print(path)


if __name__ == "__main__":
    write()
