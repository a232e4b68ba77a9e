"""Noise textures of the field, as materials of a scene, and its sun."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from models import terrain
from models.configuration import FieldConfig


def add_materials(scene: mujoco.MjSpec, field: FieldConfig) -> None:
    """Add the materials ``ground`` and ``rock`` and, where needed, ``block`` and ``panel``.

    Args:
        scene: Scene to add to.
        field: Gives the seed and the size of the textures.
    """
    seed = np.random.SeedSequence(field.seed).spawn(3)[2]
    rng = np.random.default_rng(seed)
    image = terrain.noise_texture(rng, field.texture_pixels)
    face = min(field.texture_pixels, 256)
    flat, cube = mujoco.mjtTexture.mjTEXTURE_2D, mujoco.mjtTexture.mjTEXTURE_CUBE
    _add_texture(scene, "ground", flat, image)
    _add_texture(scene, "rock", cube, np.tile(image[:face, :face], (6, 1, 1)))
    # Flat things' textures repeat by their length, which MuJoCo counts over two metres. Each face
    # of a solid bears one.
    repeats = 2.0 / field.texture_tile
    flats = ["ground"]
    solids = ["rock"]
    if field.blocks > 0 or field.screens:
        faces = [terrain.noise_texture(rng, face, terrain.BLOCK) for _ in range(6)]
        _add_texture(scene, "block", cube, np.concatenate(faces))
        solids.append("block")
    if field.panel is not None:
        image = terrain.noise_texture(rng, field.texture_pixels, terrain.PANEL)
        _add_texture(scene, "panel", flat, image)
        flats.append("panel")
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
