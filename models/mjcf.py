"""MJCF files, read within the limits of the meshes, height fields and textures that they name."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import mujoco
from PIL import UnidentifiedImageError

from perception.geometry.files import MODEL, check_picture, check_pixels, check_size

_FACES_OF_A_CUBE = 6


def read_spec(path: Path | str) -> mujoco.MjSpec:
    """Read an MJCF file, ready to be compiled.

    Args:
        path: File; what it names is checked, but not read yet.

    Raises:
        OSError: If it is missing, or it or a file or an array that it names is too large.
        ValueError: If it is not MJCF.
    """
    check_size(path, MODEL)
    spec = mujoco.MjSpec.from_file(str(path))
    for hfield in spec.hfields:
        check_pixels(f"{path}: hfield {hfield.name}", hfield.ncol, hfield.nrow)
    for texture in spec.textures:
        faces = 1 if texture.type == mujoco.mjtTexture.mjTEXTURE_2D else _FACES_OF_A_CUBE
        check_pixels(f"{path}: texture {texture.name}", texture.width, faces * texture.height)
    named = [(spec.meshdir, each.file) for each in (*spec.meshes, *spec.hfields, *spec.skins)]
    textures = [file for each in spec.textures for file in (each.file, *each.cubefiles)]
    named += [(spec.texturedir, file) for file in textures]
    _check_files(Path(path).parent / folder / file for folder, file in named if file)
    return spec


def _check_files(paths: Iterable[Path]) -> None:
    for path in paths:
        with contextlib.suppress(FileNotFoundError):  # MuJoCo says what is missing.
            check_size(path, MODEL)
            with contextlib.suppress(UnidentifiedImageError):
                check_picture(path)
