"""Image files."""

from __future__ import annotations

import warnings
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from fungrasp.errors import FungraspError
from fungrasp.formats.file_bytes import check_file, one_line

LARGEST_PIXELS = 60_000_000
"""Pixels of the largest image that is read."""

LARGEST = 500_000_000
"""Bytes of the largest file that is read."""

FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "PPM", "GIF")


def read_image(path: str | Path, what: str) -> Image.Image:
    """An image, its pixels loaded.

    Args:
        path: a file of one of ``FORMATS``.
        what: it should be, for messages: "mask".

    Raises:
        FungraspError: it can't be read, is cut short, no image or too large.
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
            image.load()
    except UnidentifiedImageError as error:
        raise FungraspError(f"{where} is not an image") from error
    except FungraspError:
        raise
    except Exception as error:
        # Pillow's decoders raise almost any exception on damaged files.
        raise FungraspError(
            f"{where} can't be read, it is damaged or cut short: {one_line(error)}"
        ) from error
    return image
