"""Image files."""

from __future__ import annotations

import warnings
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import check_file, one_line

LARGEST_PIXELS = 60_000_000
"""Pixels of the largest image that is read."""

LARGEST = 500_000_000
"""Bytes of the largest file that is read."""

ORIENTATION = 0x0112
"""EXIF tag: how the stored pixels are to be turned to be shown; 1 is as they are."""

FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "PPM", "GIF")


def read_image(path: str | Path, what: str) -> Image.Image:
    """An image, its pixels loaded.

    One that is to be shown turned or mirrored is refused: whether the other images and the intrinsics that
    belong to it are of the pixels as stored or as shown, no file says, and programs that write them differ.

    Args:
        path: a file of one of ``FORMATS``.

    Raises:
        FungraspError: it can't be read, is cut short, no image or too large, or is to be shown turned.
    """
    path = check_file(path, what, LARGEST)
    where = f"the {what} {one_line(path)}"
    try:
        with warnings.catch_warnings(action="ignore"):
            image = Image.open(path, formats=FORMATS)
            if image.width * image.height > LARGEST_PIXELS:
                raise FungraspError(
                    f"{where} has {image.width} x {image.height} pixels; the largest allowed is "
                    f"{LARGEST_PIXELS // 1_000_000} million"
                )
            # Before TIFF files are loaded, which Pillow turns then.
            turned = image.getexif().get(ORIENTATION, 1)
            if turned in range(2, 9):
                raise FungraspError(
                    f"{where} is stored turned or mirrored (EXIF orientation {turned}): turn color, depth "
                    "and intrinsics the same way, and save it without that tag"
                )
            image.load()
    except UnidentifiedImageError as error:
        raise FungraspError(
            f"{where} is none of the kinds of images that are read: {', '.join(FORMATS)}"
        ) from error
    except FungraspError:
        raise
    except Exception as error:
        # Pillow's decoders raise almost any exception on damaged files.
        raise FungraspError(
            f"{where} can't be read, it is damaged or cut short: {one_line(error)}"
        ) from error
    return image
