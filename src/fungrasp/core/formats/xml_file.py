"""XML text, parsed here to be looked into before MuJoCo reads it."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import one_line

DEEPEST_ELEMENT = 200
"""Most elements inside each other."""


def check_entities(text: str, where: str) -> None:
    """Refuse XML text that declares entities: a few lines can stand for gigabytes, or for other files.

    Raises:
        FungraspError: it does.
    """
    if "<!ENTITY" in text:
        raise FungraspError(f"{where} declares XML entities; write what they stand for")


def parse_xml_text(text: str, where: str) -> ElementTree.Element:
    """Root element of an XML document without entities of its own; ``where`` begins the messages.

    Raises:
        FungraspError: it is not valid XML, declares entities or is nested too deeply.
    """
    check_entities(text, where)
    parser = ElementTree.XMLPullParser(("start", "end"))
    root: ElementTree.Element | None = None
    depth = 0
    try:
        # In pieces, so that a document that is nested too deeply is not read to its end.
        for start in range(0, len(text), _PIECE):
            parser.feed(text[start : start + _PIECE])
            for event, element in parser.read_events():  # pyright: ignore[reportAssignmentType]
                assert isinstance(element, ElementTree.Element)
                root = element if root is None else root
                depth += 1 if event == "start" else -1
                if depth > DEEPEST_ELEMENT:
                    raise FungraspError(f"{where} is nested more than {DEEPEST_ELEMENT} levels deep")
        parser.close()
    except ElementTree.ParseError as error:
        raise FungraspError(f"{where} is not valid XML: {one_line(error)}") from error
    if root is None:
        raise FungraspError(f"{where} is not valid XML: it has no element")
    return root


_PIECE = 1 << 16
