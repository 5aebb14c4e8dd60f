"""What pages are made of: the document with its style, pictures, tables of figures, where it came from."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

import numpy as np

from fungrasp.core.errors import FungraspError

PHOTOGRAPH_QUALITY = 90
"""JPEG quality of photographs, 0 to 100."""

VERDICTS = {None: "", True: '<em class="good">good</em>', False: '<em class="bad">poor</em>'}
"""HTML that says whether a number keeps to its limits; None for a number without any."""


@dataclass(frozen=True)
class Quantity:
    """A measured number."""

    name: str
    """Name of the quantity, such as "Penetration of the object"."""
    value: float | str
    """A number, or words."""
    unit: str = ""
    """Unit of the value, such as "mm"."""
    meaning: str = ""
    """What it measures, in a sentence."""
    limit: float | None = None
    """Largest good value; None for no limit."""
    least: float | None = None
    """Smallest good value; None for no limit."""

    @property
    def good(self) -> bool | None:
        """Whether the number keeps to ``limit`` and ``least``; None if it is none, or has neither."""
        if isinstance(self.value, str) or not np.isfinite(self.value):
            return None
        if self.limit is None and self.least is None:
            return None
        return (self.limit is None or self.value <= self.limit) and (
            self.least is None or self.value >= self.least
        )


def document(title: str, parts: Sequence[str]) -> str:
    """HTML text of a page that needs no other file. parts: HTML; empty ones are left out."""
    style = files("fungrasp.media").joinpath("page.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def badge(kind: str, words: str) -> str:
    """A few words in a colored pill. kind: "good" or "bad"."""
    return f'<span class="badge {kind}">{escape(words)}</span>'


def figure(picture: np.ndarray | None, caption: str, *, photograph: bool = False) -> str:
    """A picture with words below it; nothing if there is none.

    Args:
        picture: sRGB, shape [H, W, 3] uint8.
        caption: words.
        photograph: it is noisy, and is kept as JPEG.

    Raises:
        FungraspError: the picture has the wrong shape.
    """
    if picture is None:
        return ""
    height, width = picture.shape[:2]
    return (
        f'<figure><img src="{_encoded(picture, photograph)}" width="{width}" height="{height}" '
        f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def quality_card(quality: Sequence[Quantity], title: str = "Quality") -> str:
    """A table of figures: what each means, and whether it is good where a limit says so."""
    if not quality:
        return ""
    rows = []
    for item in quality:
        unit = _unit(item.unit)
        words = [item.meaning]
        words += [f"At most {number(item.limit)}{unit}."] if item.limit is not None else []
        words += [f"At least {number(item.least)}{unit}."] if item.least is not None else []
        rows.append(
            f'<tr><th scope="row">{escape(item.name)}<small>{escape(" ".join(filter(None, words)))}</small>'
            f'</th><td class="number{" over" if item.good is False else ""}">{escape(number(item.value))}'
            f"<span>{escape(unit)}</span>{VERDICTS[item.good]}</td></tr>"
        )
    return (
        f'<section class="card"><h3>{escape(title)}</h3><table class="quality"><thead class="hidden"><tr>'
        '<th scope="col">Measure</th><th scope="col">Value</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></section>"
    )


def text_card(title: str, text: str) -> str:
    """Lines of text as they are, in columns."""
    return f'<section class="card"><h3>{escape(title)}</h3><pre>{escape(text)}</pre></section>'


def provenance_footer(provenance: Mapping[str, str]) -> str:
    """Where it all came from, in the order given."""
    if not provenance:
        return ""
    rows = "".join(
        f"<div><dt>{escape(key)}</dt><dd>{escape(str(value))}</dd></div>" for key, value in provenance.items()
    )
    return f"<footer><h2>Where this came from</h2><dl>{rows}</dl></footer>"


def number(value: float | str | None) -> str:
    """Three digits of a number; words as they are."""
    if value is None or isinstance(value, str):
        return value or ""
    if not np.isfinite(value):
        return "–"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _unit(unit: str) -> str:
    return unit if unit in ("", "°", "%") else f" {unit}"


def _encoded(picture: np.ndarray, photograph: bool) -> str:
    from PIL import Image

    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise FungraspError(f"a picture must have shape [H, W, 3] uint8, not {picture.shape} {picture.dtype}")
    buffer = io.BytesIO()
    if photograph:
        Image.fromarray(picture).save(buffer, "JPEG", quality=PHOTOGRAPH_QUALITY, subsampling=0)
    else:
        Image.fromarray(picture).save(buffer, "PNG")
    kind = "jpeg" if photograph else "png"
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"
