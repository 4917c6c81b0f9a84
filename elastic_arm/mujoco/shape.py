"""XML that keeps its form: a changed tree as text, with the original spelling of the rest."""

import re
from collections.abc import Mapping
from difflib import SequenceMatcher
from typing import Any

from lxml import etree

from elastic_arm.errors import RobotError

_TOKEN = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<[^>]*>|[^<]+", re.DOTALL)


class ShapedXml:
    """A file as lxml's tree, and its text."""

    def __init__(self, text: bytes, what: str) -> None:
        # Entities of a file that somebody sent are not expanded, and nothing is fetched.
        parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=False)
        try:
            self.root = etree.fromstring(text, parser)
        except etree.XMLSyntaxError as error:
            raise RobotError(f"{what}: {' '.join(str(error).split())}", "Correct the XML") from None
        self._original = text.decode(
            self.root.getroottree().docinfo.encoding or "utf-8", errors="replace"
        )
        self._plain = self._serialised()

    def text(self) -> str:
        """Return the file with what changed in the tree; the rest is the original to the letter."""
        before = _TOKEN.findall(self._original)
        plain = _TOKEN.findall(self._plain)
        after = _TOKEN.findall(self._serialised())
        elements = [k for k, token in enumerate(before) if token[0] == "<" and token[1] not in "?!"]
        # What stands around the root element is the original's.
        body = before[elements[0] : elements[-1] + 1]
        lead = before[: elements[0]]
        trail = before[elements[-1] + 1 :]
        if len(body) != len(plain):
            # Spellings that lxml does not keep, such as <a></a>: the whole is as lxml writes it.
            return "".join([*lead, *after, *trail])
        found: list[str] = []
        for kind, i, j, k, m in SequenceMatcher(None, plain, after, autojunk=False).get_opcodes():
            found += body[i:j] if kind == "equal" else after[k:m]
        return "".join([*lead, *found, *trail])

    def _serialised(self) -> str:
        return etree.tostring(self.root, encoding="unicode", with_tail=False)


def insert_first(parent: Any, tag: str) -> Any:
    """Insert an element as the first child, on a line of its own, and return it."""
    element = etree.Element(tag)
    element.tail = parent.text if parent.text and not parent.text.strip() else "\n"
    parent.insert(0, element)
    return element


def append_last(parent: Any, tag: str, namespaces: Mapping[str, str] | None = None) -> Any:
    """Insert an element as the last child, on a line of its own, and return it.

    namespaces: prefixes that it declares where none of its parents does.
    """
    element = etree.SubElement(parent, tag, nsmap=dict(namespaces or {}))
    if len(parent) > 1:
        previous = parent[-2]
        element.tail = previous.tail
        previous.tail = parent.text
    return element
