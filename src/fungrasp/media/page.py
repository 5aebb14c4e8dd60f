"""One self-contained HTML page about grasps: pictures, contacts, numbers, the film, and where it all came
from.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.media.page_parts import Quantity, badge, document, figure, provenance_footer, quality_card

__all__ = ["MEDIA_TYPES", "Contact", "GraspReport", "Page", "Quantity", "page_html", "write_page"]

MEDIA_TYPES = {".mp4": "video/mp4", ".webp": "image/webp", ".gif": "image/gif", ".png": "image/png"}
"""Kinds of files that a page can hold, by suffix."""


@dataclass(frozen=True)
class Contact:
    """Whether a link of the robot's hand should touch the object, and does."""

    link: str
    """Name of the link."""
    target: bool
    """Whether the link should touch the object."""
    reached: bool | None = None
    """Whether the link touched the object; None if it was not tried."""


@dataclass(frozen=True)
class GraspReport:
    """What the page says about one grasp. What is None or empty is left out."""

    title: str
    """Heading of the grasp, such as "Mug, to drink"."""
    task: str = ""
    """What the grasp is for."""
    object_name: str = ""
    """Name of the object."""
    object_mass: float | None = None
    """Mass of the object [kg]."""
    success: bool | None = None
    """Whether the object was lifted and held; None if it was not tried."""
    outcome: str = ""
    """What happened, in a sentence."""
    human_picture: np.ndarray | None = None
    """Picture of the human grasp, sRGB, shape [H, W, 3] uint8; None if there is none."""
    robot_picture: np.ndarray | None = None
    """Picture of the robot grasp, sRGB, shape [H, W, 3] uint8; None if there is none."""
    film: Path | bytes | None = None
    """Film of the episode: a file of a kind in ``MEDIA_TYPES``, or the bytes of an mp4 file."""
    use_success: bool | None = None
    """Whether the use test that followed was passed; None if there was none."""
    use_outcome: str = ""
    """What happened in it, in a sentence."""
    use_film: Path | bytes | None = None
    """Film of it, as ``film``."""
    contacts: Sequence[Contact] = ()
    """Links that should touch, and whether they did."""
    quality: Sequence[Quantity] = ()
    """Numbers for the quality of the grasp."""


@dataclass(frozen=True)
class Page:
    """All that a page says."""

    title: str
    """Title of the page."""
    grasps: Sequence[GraspReport]
    """The grasps, in the order of the page."""
    hand: str = ""
    """Title of the robot's hand."""
    introduction: str = ""
    """A sentence or two under the title."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Where it came from: version, seed, command, machine, date ..., in the order given."""


def write_page(path: str | Path, page: Page, opening: Sequence[str] = ()) -> Path:
    """Write a page that needs no other file and no network.

    Args:
        path: of the HTML file.
        page: what it says.
        opening: HTML of what comes before the grasps.

    Raises:
        FungraspError: a film can't be read or is of an unknown kind, a picture has the wrong shape, or the
            page can't be written.
    """
    path = Path(path)
    text = page_html(page, opening)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def page_html(page: Page, opening: Sequence[str] = ()) -> str:
    """The page's HTML text. Raises FungraspError as ``write_page``."""
    several = len(page.grasps) > 1
    parts = [_header(page), *opening, *(_contents(page.grasps) if several else [])]
    parts += [_grasp(grasp, f"grasp-{i + 1}", first=i == 0) for i, grasp in enumerate(page.grasps)]
    return document(page.title, [*parts, provenance_footer(page.provenance)])


def _header(page: Page) -> str:
    tried = [grasp.success for grasp in page.grasps if grasp.success is not None]
    facts = [page.hand, f"{len(page.grasps)} grasps" if len(page.grasps) > 1 else ""]
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
        f'<li><a href="#grasp-{i + 1}">{escape(grasp.title)}</a>{_badge(grasp.success, small=True)}</li>'
        for i, grasp in enumerate(grasps)
    )
    return [f'<nav aria-label="Grasps"><ol>{links}</ol></nav>']


def _grasp(grasp: GraspReport, name: str, *, first: bool) -> str:
    facts = [grasp.task, grasp.object_name]
    if grasp.object_mass is not None:
        facts.append(f"{1000 * grasp.object_mass:.0f} g")
    line = " · ".join(escape(fact) for fact in facts if fact)
    pictures = figure(grasp.human_picture, "The human grasp; links in contact are orange")
    pictures += figure(grasp.robot_picture, "The robot's grasp")
    lift = f"Film of the robot's grasp: {grasp.title}"
    film = _film(grasp.film, lift, "In simulation", " autoplay" if first else "")
    film += _film(grasp.use_film, f"Film of its use: {grasp.title}", "Its use, after the hold", "")
    tables = _contacts(grasp.contacts) + quality_card(grasp.quality)
    outcome = " ".join(filter(None, (grasp.outcome, grasp.use_outcome)))
    return (
        f'<article id="{name}" aria-labelledby="{name}-title"><header>'
        f'<div><h2 id="{name}-title">{escape(grasp.title)}</h2>'
        + (f'<p class="facts">{line}</p>' if line else "")
        + f"</div><div>{_badge(grasp.success)}{_use_badge(grasp.use_success)}</div></header>"
        + (f'<p class="outcome">{escape(outcome)}</p>' if outcome else "")
        + (f'<div class="pictures">{pictures}</div>' if pictures else "")
        + (f'<div class="films">{film}</div>' if film else "")
        + (f'<div class="tables">{tables}</div>' if tables else "")
        + "</article>"
    )


def _badge(success: bool | None, *, small: bool = False) -> str:
    if success is None:
        return ""
    kind, words = ("good", "✓ Lifted and held") if success else ("bad", "✗ Not held")
    return badge(kind, words[0] if small else words)


def _use_badge(success: bool | None) -> str:
    if success is None:
        return ""
    return " " + (badge("good", "✓ Used") if success else badge("bad", "✗ Use failed"))


def _film(film: Path | bytes | None, alt: str, caption: str, play: str) -> str:
    if film is None:
        return ""
    kind, data = _media(film)
    source, alt = f"data:{kind};base64,{base64.b64encode(data).decode()}", escape(alt)
    if kind.startswith("image/"):
        inner = f'<img src="{source}" alt="{alt}">'
    else:
        inner = f'<video src="{source}" controls{play} muted loop playsinline aria-label="{alt}"></video>'
    return f'<figure class="film">{inner}<figcaption>{escape(caption)}</figcaption></figure>'


def _contacts(contacts: Sequence[Contact]) -> str:
    if not contacts:
        return ""
    rows = "".join(
        f'<tr><th scope="row">{escape(contact.link.replace("_", " "))}</th><td>{_dot(contact.target)}</td>'
        f"<td>{_dot(contact.reached)}</td></tr>"
        for contact in contacts
    )
    wanted = [c for c in contacts if c.target and c.reached is not None]
    summary = (
        f"{sum(bool(c.reached) for c in wanted)} of {len(wanted)} wanted contacts reached" if wanted else ""
    )
    return (
        '<section class="card"><h3>Contacts</h3>'
        + (f"<p>{summary}</p>" if summary else "")
        + '<table class="contacts"><thead><tr><th scope="col">Link</th><th scope="col">Wanted</th>'
        f'<th scope="col">Reached</th></tr></thead><tbody>{rows}</tbody></table></section>'
    )


def _dot(value: bool | None) -> str:
    if value is None:
        return '<span class="none">not tried</span>'
    return (
        '<span class="dot on" title="yes">yes</span>' if value else '<span class="dot" title="no">no</span>'
    )


def _media(film: Path | bytes) -> tuple[str, bytes]:
    if isinstance(film, bytes):
        return MEDIA_TYPES[".mp4"], film
    kind = MEDIA_TYPES.get(film.suffix.lower())
    if kind is None:
        raise FungraspError(f"{film}: a film on a page must be one of {', '.join(MEDIA_TYPES)}")
    try:
        return kind, film.read_bytes()
    except OSError as error:
        raise FungraspError(f"cannot read {film}: {error.strerror or error}") from error
