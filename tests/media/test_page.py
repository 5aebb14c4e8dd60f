import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.media.page import Contact, GraspReport, Page, Quantity, page_html, write_page
from fungrasp.media.video import write_video

NASTY = "<script>alert('x')</script> & \"quotes\""
VOID = {"meta", "img", "link", "br"}


class _Checker(HTMLParser):
    """Collects texts and attributes, and checks that tags are closed in order."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.sources, self.text = [], [], [], ""

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for key, value in attrs if key in ("src", "href", "poster", "srcset")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def _check(html):
    checker = _Checker()
    checker.feed(html)
    checker.close()
    assert not checker.open
    return checker


def _picture(value=90):
    picture = np.full((12, 16, 3), value, np.uint8)
    picture[3:6, 4:9] = (240, 120, 30)
    return picture


def _grasp(**changes):
    return GraspReport(
        **{
            "title": "Mug, to drink",
            "object_mass": 0.25,
            "success": True,
            "outcome": "Lifted 15 cm.",
            "human_picture": _picture(),
            "robot_picture": _picture(120),
            "contacts": [
                Contact("palm", False, False),
                Contact("index_distal", True, True),
                Contact("thumb_distal", True, False),
            ],
            "quality": [
                Quantity("Contact error", 6.234, "mm", "How far apart.", 5.0),
                Quantity("Force closure", 0.041),
            ],
            **changes,
        }
    )


def test_a_page_says_everything(tmp_path):
    page = Page(
        "Grasps", [_grasp()], "Allegro", "An introduction.", {"seed": "0", "command": "fungrasp demo"}
    )
    path = write_page(tmp_path / "page.html", page)
    assert path.read_text(encoding="utf-8").count('class="number over"') == 1
    checker = _check(path.read_text(encoding="utf-8"))
    wanted = ("Grasps", "Allegro", "An introduction.", "Mug, to drink", "250 g", "Lifted 15 cm.", "6.23")
    results = ("Lifted and held", "1 of 2 wanted contacts reached", "index distal", "At most 5 mm.")
    for words in (*wanted, *results, "fungrasp demo"):
        assert words in checker.text
    assert {"article", "header", "figure", "table", "footer", "dl"} <= set(checker.tags)


def test_a_page_needs_nothing_from_outside(tmp_path):
    film = write_video(tmp_path / "film.mp4", [_picture(), _picture(50)], 10)
    html = page_html(Page("Grasps", [_grasp(film=film), _grasp(film=film)]))
    checker = _check(html)
    assert len(checker.sources) == 4 + 2 + 2
    assert all(source.startswith(("data:", "#")) for source in checker.sources)
    assert not re.search(r"https?://|url\(|@import|<script|<link", html)


def test_pictures_and_films_are_inside_unchanged(tmp_path):
    film = write_video(tmp_path / "film.mp4", [_picture(), _picture(50)], 10)
    html = page_html(Page("Grasps", [_grasp(film=film)]))
    human, _, video = re.findall(r'src="data:[a-z]+/[a-z0-9]+;base64,([^"]+)"', html)
    with Image.open(io.BytesIO(base64.b64decode(human))) as image:
        np.testing.assert_array_equal(np.asarray(image), _picture())
    assert base64.b64decode(video) == film.read_bytes()


def test_every_text_is_escaped():
    grasp = _grasp(
        title=NASTY,
        outcome=NASTY,
        contacts=[Contact(NASTY, True, True)],
        quality=[Quantity(NASTY, NASTY, NASTY, NASTY)],
    )
    html = page_html(Page(NASTY, [grasp, grasp], NASTY, NASTY, {NASTY: NASTY}))
    assert "<script" not in html
    checker = _check(html)
    assert checker.text.count("<script>alert('x')</script>") >= 16


def test_what_is_missing_is_left_out():
    checker = _check(page_html(Page("Nothing yet", [GraspReport("Bare")])))
    assert not {"img", "video", "table", "footer", "nav"} & set(checker.tags)
    assert "held" not in checker.text


def test_held_otherwise_than_shown_is_said():
    grasps = [_grasp(as_shown=True), _grasp(as_shown=False), _grasp(success=False, as_shown=False)]
    html = page_html(Page("Grasps", grasps))
    text = _check(html).text
    assert "1 of 3 held as shown · 2 of 3 lifted and held" in text
    assert (
        text.count("✓ Held as shown") == text.count("✗ Held, not as shown") == text.count("✗ Not held") == 1
    )
    assert html.count('badge good">') == 2, "as many in the list"


def test_use_is_judged_by_itself(tmp_path):
    (tmp_path / "use.mp4").write_bytes(b"film")
    failed = _grasp(use_success=False, use_outcome="It slipped.", use_film=tmp_path / "use.mp4")
    html = page_html(Page("Grasps", [failed]))
    text = _check(html).text
    assert "✓ Lifted and held" in text and "✗ Use failed" in text and "It slipped." in text
    assert html.count("<video") == 1
    html = page_html(Page("Grasps", [_grasp(use_success=True), _grasp(use_success=False), _grasp()]))
    assert "1 of 2 used" in _check(html).text and html.count("✓ Used") == 1


@pytest.mark.parametrize("film", ["missing.mp4", "film.avi"])
def test_bad_films_are_named(tmp_path, film):
    with pytest.raises(FungraspError, match=film):
        write_page(tmp_path / "page.html", Page("Grasps", [_grasp(film=tmp_path / film)]))
    assert not list(tmp_path.iterdir())


def test_bad_pictures_are_refused():
    with pytest.raises(FungraspError, match="picture"):
        page_html(Page("Grasps", [_grasp(human_picture=np.zeros((4, 4)))]))
