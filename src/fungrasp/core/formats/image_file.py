"""Image files."""

from __future__ import annotations

import warnings
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import check_file, one_line

LARGEST_PIXELS = 60_000_000
"""Maximum number of pixels of an image."""

LARGEST = 500_000_000
"""Maximum size of a file [bytes]."""

ORIENTATION = 0x0112
"""EXIF tag of the orientation; 1 for unrotated pixels."""

FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "PPM", "GIF")


def read_image(path: str | Path, what: str) -> Image.Image:
    """Read an image with its pixels.

    Images with an EXIF rotation or reflection are refused, because it is unknown whether their intrinsics and
    the other images refer to the stored or the displayed pixels.

    Args:
        path: a file in one of ``FORMATS``.

    Raises:
        FungraspError: the file can't be read, is truncated, not an image, too large, or rotated by EXIF.
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
            # Check before loading, because Pillow then rotates TIFF files.
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
