"""Pictures as the report holds them: smaller than the files, and still sharp in print."""

import base64
import dataclasses
import io
from pathlib import Path

from PIL import Image

from experiments.harness.contract import ExperimentError
from perception.geometry.files import check_picture

WIDTH = 1600  # [px] Wider ones are reduced: twice the widest column of the page.
QUALITY = 85


@dataclasses.dataclass(frozen=True)
class Embedded:
    """A picture for an ``img`` element.

    Attributes:
        url: The picture itself, as a data URL.
        width: Width [px], so that the page does not move while it is laid out.
        height: Height [px].
    """

    url: str
    width: int
    height: int


def embed(path: Path, width: int = WIDTH) -> Embedded:
    """Return a picture as WebP, or as it is where that is smaller.

    Args:
        path: PNG file.
        width: Width to which wider ones are reduced [px].

    Raises:
        ExperimentError: If it is no picture, a damaged one, or a larger one than is read.
    """
    try:
        check_picture(path)
        raw = path.read_bytes()
        with Image.open(io.BytesIO(raw)) as picture:
            small = _on_white(picture)
    except (OSError, ValueError, SyntaxError) as error:  # Pillow's, of damaged files.
        raise ExperimentError(f"{path}: no picture ({error})") from None
    if small.width > width:
        small = small.resize(
            (width, round(small.height * width / small.width)), Image.Resampling.LANCZOS
        )
    stream = io.BytesIO()
    small.save(stream, "WEBP", quality=QUALITY, method=2)
    kind, data = min((("webp", stream.getvalue()), ("png", raw)), key=lambda pair: len(pair[1]))
    return Embedded(
        f"data:image/{kind};base64,{base64.b64encode(data).decode()}", small.width, small.height
    )


def _on_white(picture: Image.Image) -> Image.Image:
    """Return a picture without transparency, on the white ground of figures."""
    if "A" not in picture.getbands() and "transparency" not in picture.info:
        return picture.convert("RGB")
    page = Image.new("RGBA", picture.size, "white")
    page.alpha_composite(picture.convert("RGBA"))
    return page.convert("RGB")
