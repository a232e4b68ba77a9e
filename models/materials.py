"""Noise textures of the field, as materials of a scene, and its sun."""

import functools
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from models import terrain
from models.configuration import FieldConfig

_SOLIDS = ("rock", "block")


def add_materials(scene: mujoco.MjSpec, field: FieldConfig) -> None:
    """Add the materials ``ground`` and ``rock`` and, where needed, ``block`` and ``panel``.

    Args:
        scene: Scene to add to.
        field: Gives the seed and the size of the textures.
    """
    seed = np.random.SeedSequence(field.seed).spawn(3)[2]
    has_solids, has_panel = field.blocks > 0 or bool(field.screens), field.panel is not None
    entropy: Any = seed.entropy  # A number, as `field.seed` is.
    images = _images((int(entropy), *seed.spawn_key), field.texture_pixels, has_solids, has_panel)
    flat, cube = mujoco.mjtTexture.mjTEXTURE_2D, mujoco.mjtTexture.mjTEXTURE_CUBE
    for name, image in images.items():
        _add_texture(scene, name, cube if name in _SOLIDS else flat, image)
    # Flat things' textures repeat by their length, which MuJoCo counts over two metres. Each face
    # of a solid bears one.
    repeats = 2.0 / field.texture_tile
    flats = [name for name in images if name not in _SOLIDS]
    solids = [name for name in images if name in _SOLIDS]
    for name in (*flats, *solids):
        textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
        textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
        scene.add_material(
            name=name,
            textures=textures,
            texrepeat=[repeats, repeats] if name in flats else [1.0, 1.0],
            texuniform=name in flats,
            specular=0.0,
            shininess=0.0,
        )


@functools.lru_cache(maxsize=4)
def _images(
    seed: tuple[int, ...], pixels: int, has_solids: bool, has_panel: bool
) -> dict[str, NDArray[np.uint8]]:
    """Return textures by name, those of a solid's six faces below each other.

    They are kept, as they take longer than all else of a scene, and many scenes have the same seed.

    Args:
        seed: Entropy of the seed, and its place among its parent's children.
        pixels: Edge of the textures of flat things.
        has_solids: Whether blocks or screens are there.
        has_panel: Whether a panel is there.
    """
    entropy, *key = seed
    rng = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=key))
    image = terrain.noise_texture(rng, pixels)
    face = min(pixels, 256)
    images = {"ground": image, "rock": np.tile(image[:face, :face], (6, 1, 1))}
    if has_solids:
        faces = [terrain.noise_texture(rng, face, terrain.BLOCK) for _ in range(6)]
        images["block"] = np.concatenate(faces)
    if has_panel:
        images["panel"] = terrain.noise_texture(rng, pixels, terrain.PANEL)
    for each in images.values():
        each.setflags(write=False)
    return images


def draw_sun(scene: mujoco.MjSpec, field: FieldConfig) -> None:
    """Let the sun shine, and throw shadows on the whole field, from where the seed has it.

    Args:
        scene: Scene with the light ``sun``, whose direction is replaced.
        field: Gives the seed, the range of elevations and the size.
    """
    if field.sun_elevation is None:
        return
    rng = np.random.default_rng(np.random.SeedSequence(field.seed).spawn(5)[4])
    azimuth, elevation = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*field.sun_elevation)
    level = math.cos(elevation)
    towards = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    sun = scene.light("sun")
    # MuJoCo draws the shadows of a directional light within `shadowclip` of the line through `pos`.
    reach = 0.5 * math.hypot(*field.size)
    sun.pos, sun.dir = (reach + 1.0) * towards, -towards
    scene.visual.map.shadowclip = reach / scene.stat.extent


def _add_texture(
    scene: mujoco.MjSpec, name: str, kind: mujoco.mjtTexture, image: NDArray[np.uint8]
) -> None:
    height, width, channels = image.shape
    texture = scene.add_texture(name=name, type=kind, width=width, height=height, nchannel=channels)
    texture.data = image.tobytes()
