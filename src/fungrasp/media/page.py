"""Self-contained HTML pages: elements, and the page about grasps with pictures, contacts, numbers, videos and
provenance.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, check_suffix

PHOTOGRAPH_QUALITY = 90
"""JPEG quality of photographs, 0 to 100."""

VERDICTS = {None: "", True: '<em class="good">good</em>', False: '<em class="bad">poor</em>'}
"""HTML of the verdict on a number; None for a number without limits."""


@dataclass(frozen=True)
class Quantity:
    """A measured number."""

    name: str
    """Name of the quantity, such as "Penetration of the object"."""
    value: float | str
    """A number or text."""
    unit: str = ""
    """Unit of the value, such as "mm"."""
    meaning: str = ""
    """Meaning in a sentence."""
    limit: float | None = None
    """Largest good value; None for no limit."""
    least: float | None = None
    """Smallest good value; None for no limit."""

    @property
    def good(self) -> bool | None:
        """Whether the number is within ``limit`` and ``least``; None for text, NaN or no limits."""
        if isinstance(self.value, str) or not np.isfinite(self.value):
            return None
        if self.limit is None and self.least is None:
            return None
        return (self.limit is None or self.value <= self.limit) and (
            self.least is None or self.value >= self.least
        )


def document(title: str, parts: Sequence[str]) -> str:
    """Return the HTML text of a self-contained page. parts: HTML; empty parts are omitted."""
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
    """Return a colored label. kind: "good" or "bad"."""
    return f'<span class="badge {kind}">{escape(words)}</span>'


def figure(picture: np.ndarray | None, caption: str, *, photograph: bool = False) -> str:
    """Return a figure with a caption; "" without a picture.

    Args:
        picture: sRGB, shape [H, W, 3] uint8.
        photograph: whether to store a JPEG instead of a PNG.

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
    """Return a table of numbers with their meanings and, for those with limits, verdicts."""
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
    """Return a card with preformatted text."""
    return f'<section class="card"><h3>{escape(title)}</h3><pre>{escape(text)}</pre></section>'


def provenance_footer(provenance: Mapping[str, str]) -> str:
    """Return a footer with the provenance, in the order given."""
    if not provenance:
        return ""
    rows = "".join(
        f"<div><dt>{escape(key)}</dt><dd>{escape(str(value))}</dd></div>" for key, value in provenance.items()
    )
    return f"<footer><h2>Where this came from</h2><dl>{rows}</dl></footer>"


def number(value: float | str | None) -> str:
    """Return a number with three significant digits; text is unchanged."""
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


@dataclass(frozen=True)
class Contact:
    """Target and actual contact of a link of the robot hand."""

    link: str
    """Name of the link."""
    target: bool
    """Whether the link should touch the object."""
    reached: bool
    """Whether the link touched the object."""


@dataclass(frozen=True)
class GraspReport:
    """Content of the page about one grasp. None and empty values are omitted."""

    title: str
    """Heading of the grasp, such as "Mug, to drink"."""
    object_mass: float | None = None
    """Mass of the object [kg]."""
    success: bool | None = None
    """Whether the object was lifted and held; None if it was not tried."""
    as_shown: bool | None = None
    """Whether it was held as shown; None if it was not tried or the human contact points are unknown."""
    outcome: str = ""
    """Outcome in a sentence."""
    human_picture: np.ndarray | None = None
    """Picture of the human grasp, sRGB, shape [H, W, 3] uint8; None if there is none."""
    robot_picture: np.ndarray | None = None
    """Picture of the robot grasp, sRGB, shape [H, W, 3] uint8; None if there is none."""
    film: Path | None = None
    """Video of the episode, an mp4 file."""
    use_success: bool | None = None
    """Whether the use test was passed; None if there was none."""
    use_outcome: str = ""
    """Outcome of the use test in a sentence."""
    use_film: Path | None = None
    """Video of the use test, an mp4 file."""
    contacts: Sequence[Contact] = ()
    """Links that should touch or did."""
    quality: Sequence[Quantity] = ()
    """Numbers for the quality of the grasp."""
    before: Sequence[str] = ()
    """HTML before the report, about the image that shows the grasp."""


@dataclass(frozen=True)
class Page:
    """Content of a page."""

    title: str
    """Title of the page."""
    grasps: Sequence[GraspReport]
    """The grasps, in the order of the page."""
    hand: str = ""
    """Title of the robot's hand."""
    introduction: str = ""
    """Introduction under the title."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Provenance: version, seed, command, machine, date, ..., in the order given."""


def write_page(path: str | Path, page: Page, opening: Sequence[str] = ()) -> Path:
    """Write a self-contained page.

    Args:
        opening: HTML before the grasps.

    Raises:
        FungraspError: a video can't be read or is not an mp4 file, a picture has the wrong shape, or the page
            can't be written.
    """
    path = check_suffix(path, "a page", ".html")
    text = page_html(page, opening)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def page_html(page: Page, opening: Sequence[str] = ()) -> str:
    """Return the page's HTML text. Raises FungraspError as ``write_page``."""
    several = len(page.grasps) > 1
    parts = [_header(page), *opening, *(_contents(page.grasps) if several else [])]
    parts += [_grasp(grasp, f"grasp-{i + 1}", first=i == 0) for i, grasp in enumerate(page.grasps)]
    return document(page.title, [*parts, provenance_footer(page.provenance)])


def _header(page: Page) -> str:
    tried = [grasp.success for grasp in page.grasps if grasp.success is not None]
    facts = [page.hand, f"{len(page.grasps)} grasps" if len(page.grasps) > 1 else ""]
    shown = [grasp.as_shown for grasp in page.grasps if grasp.as_shown is not None]
    facts.append(f"{sum(shown)} of {len(tried)} held as shown" if len(tried) > 1 and shown else "")
    facts.append(f"{sum(tried)} of {len(tried)} lifted and held" if len(tried) > 1 else "")
    used = [grasp.use_success for grasp in page.grasps if grasp.use_success is not None]
    facts.append(f"{sum(used)} of {len(used)} used" if len(used) > 1 else "")
    line = " · ".join(escape(fact) for fact in facts if fact)
    return (
        f'<header class="top"><h1>{escape(page.title)}</h1>'
        + (f'<p class="facts">{line}</p>' if line else "")
        + (f"<p>{escape(page.introduction)}</p>" if page.introduction else "")
        + "</header>"
    )


def _contents(grasps: Sequence[GraspReport]) -> list[str]:
    links = "".join(
        f'<li><a href="#grasp-{i + 1}">{escape(grasp.title)}</a>{_badge(grasp, small=True)}</li>'
        for i, grasp in enumerate(grasps)
    )
    return [f'<nav aria-label="Grasps"><ol>{links}</ol></nav>']


def _grasp(grasp: GraspReport, name: str, *, first: bool) -> str:
    line = "" if grasp.object_mass is None else f"{1000 * grasp.object_mass:.0f} g"
    pictures = figure(grasp.human_picture, "The human grasp; links in contact are orange")
    pictures += figure(grasp.robot_picture, "The robot's grasp")
    lift = f"Film of the robot's grasp: {grasp.title}"
    film = _film(grasp.film, lift, "In simulation", " autoplay" if first else "")
    film += _film(grasp.use_film, f"Film of its use: {grasp.title}", "Its use, after the hold", "")
    tables = _contacts(grasp.contacts) + quality_card(grasp.quality)
    outcome = " ".join(filter(None, (grasp.outcome, grasp.use_outcome)))
    return (
        "".join(grasp.before) + f'<article id="{name}" aria-labelledby="{name}-title"><header>'
        f'<div><h2 id="{name}-title">{escape(grasp.title)}</h2>'
        + (f'<p class="facts">{line}</p>' if line else "")
        + f"</div><div>{_badge(grasp)}{_use_badge(grasp.use_success)}</div></header>"
        + (f'<p class="outcome">{escape(outcome)}</p>' if outcome else "")
        + (f'<div class="pictures">{pictures}</div>' if pictures else "")
        + (f'<div class="films">{film}</div>' if film else "")
        + (f'<div class="tables">{tables}</div>' if tables else "")
        + "</article>"
    )


def _badge(grasp: GraspReport, *, small: bool = False) -> str:
    if grasp.success is None:
        return ""
    held = {None: "✓ Lifted and held", True: "✓ Held as shown", False: "✗ Held, not as shown"}[grasp.as_shown]
    words = held if grasp.success else "✗ Not held"
    return badge("good" if words[0] == "✓" else "bad", words[0] if small else words)


def _use_badge(success: bool | None) -> str:
    if success is None:
        return ""
    return " " + (badge("good", "✓ Used") if success else badge("bad", "✗ Use failed"))


def _film(film: Path | None, alt: str, caption: str, play: str) -> str:
    if film is None:
        return ""
    if film.suffix != ".mp4":
        raise FungraspError(f"{film}: a film on a page must be an mp4 file")
    try:
        source = f"data:video/mp4;base64,{base64.b64encode(film.read_bytes()).decode()}"
    except OSError as error:
        raise FungraspError(f"cannot read {film}: {error.strerror or error}") from error
    inner = f'<video src="{source}" controls{play} muted loop playsinline aria-label="{escape(alt)}"></video>'
    return f'<figure class="film">{inner}<figcaption>{escape(caption)}</figcaption></figure>'


def _contacts(contacts: Sequence[Contact]) -> str:
    if not contacts:
        return ""
    rows = "".join(
        f'<tr><th scope="row">{escape(contact.link.replace("_", " "))}</th><td>{_dot(contact.target)}</td>'
        f"<td>{_dot(contact.reached)}</td></tr>"
        for contact in contacts
    )
    wanted = [contact.reached for contact in contacts if contact.target]
    summary = f"{sum(wanted)} of {len(wanted)} wanted contacts reached" if wanted else ""
    return (
        '<section class="card"><h3>Contacts</h3>'
        + (f"<p>{summary}</p>" if summary else "")
        + '<table class="contacts"><thead><tr><th scope="col">Link</th><th scope="col">Wanted</th>'
        f'<th scope="col">Reached</th></tr></thead><tbody>{rows}</tbody></table></section>'
    )


def _dot(value: bool) -> str:
    return (
        '<span class="dot on" title="yes">yes</span>' if value else '<span class="dot" title="no">no</span>'
    )
