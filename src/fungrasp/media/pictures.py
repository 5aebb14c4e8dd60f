"""Contact sheets, words on pictures, a thing from four sides; and the ways to scenes and views of a grasp."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from fungrasp.core.errors import FungraspError
from fungrasp.media.ray_tracing import Look
from fungrasp.media.render import Renderer
from fungrasp.media.viewpoints import frame_geoms

INK = (38, 42, 48)
PAPER = (250, 250, 248)


def grid(
    images: Sequence[np.ndarray],
    labels: Sequence[str] = (),
    columns: int = 4,
    *,
    gap: int = 10,
    size: int = 15,
) -> np.ndarray:
    """A contact sheet: pictures in rows, a caption under each.

    Args:
        images: sRGB, each of shape [H, W, 3] uint8, all of one size.
        labels: one per image, or none; what is too long for its picture is shortened.
        columns: pictures in a row.
        gap: space between pictures [pixels].
        size: of the letters [pixels].

    Returns:
        sRGB, shape [H', W', 3] uint8.

    Raises:
        FungraspError: no images, images of different shapes, or a wrong number of labels.
    """
    if not images or columns < 1:
        raise FungraspError("a contact sheet needs at least one picture and one column")
    shape = images[0].shape
    if any(image.shape != shape for image in images):
        raise FungraspError(f"the pictures of a contact sheet must all have the shape of the first, {shape}")
    if labels and len(labels) != len(images):
        raise FungraspError(f"{len(labels)} labels were given for {len(images)} pictures")
    height, width = shape[:2]
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    text = round(1.9 * size) if labels else 0
    sheet = Image.new("RGB", (gap + columns * (width + gap), gap + rows * (height + text + gap)), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size)
    for i, image in enumerate(images):
        x, y = gap + i % columns * (width + gap), gap + i // columns * (height + text + gap)
        sheet.paste(Image.fromarray(image), (x, y))
        if labels:
            label = _shortened(labels[i], font, width)
            draw.text((x + width / 2, y + height + text / 2), label, fill=INK, font=font, anchor="mm")
    return np.asarray(sheet)


def captioned(image: np.ndarray, left: str, right: str = "") -> np.ndarray:
    """A picture with a bar of words along its lower edge.

    Args:
        image: sRGB, shape [H, W, 3] uint8.
        left: words at the left end of the bar.
        right: words at its right end.

    Returns:
        a new picture of the same shape.
    """
    height, width = image.shape[:2]
    size = max(10, round(height / 26))
    bar = round(2.1 * size)
    picture = Image.fromarray(image)
    shade = Image.new("RGB", (width, bar), (24, 27, 32))
    below = picture.crop((0, height - bar, width, height))
    picture.paste(Image.blend(below, shade, 0.72), (0, height - bar))
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(size)
    middle = height - bar / 2
    taken = draw.textlength(right, font=font) + 2 * size
    room = width - taken - 1.5 * size
    draw.text((size, middle), _shortened(left, font, room), fill=(248, 248, 246), font=font, anchor="lm")
    draw.text((width - size, middle), right, fill=(205, 209, 214), font=font, anchor="rm")
    return np.asarray(picture)


def four_views(
    model: mujoco.MjModel,
    qpos: np.ndarray | None = None,
    *,
    width: int = 480,
    height: int = 360,
    azimuth: float = -60.0,
    look: Look | None = None,
) -> list[np.ndarray]:
    """A thing from four sides, a quarter turn apart, alternately from low and from high, for ``grid``.

    Args:
        qpos: shape [nq]; None for the model's reference.
        azimuth: of the first view [degrees].

    Returns:
        four pictures, sRGB, shape [height, width, 3] uint8.
    """
    state = np.asarray(model.qpos0 if qpos is None else qpos, dtype=float)
    renderer = Renderer(model, look=look)
    cameras = [
        frame_geoms(model, state, azimuth + 90.0 * i, 22.0 + 18.0 * (i % 2), width=width, height=height)
        for i in range(4)
    ]
    return [next(renderer.stream(state, camera)) for camera in cameras]


def _shortened(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, room: float) -> str:
    text = " ".join(text.split())
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text.rstrip() + "…"
