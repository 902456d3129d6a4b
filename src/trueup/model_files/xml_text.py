# SPDX-License-Identifier: Apache-2.0
"""MJCF and URDF as text: changes attributes of single start tags and leaves every other byte of the file as it is."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from trueup import files
from trueup.errors import ModelError


@dataclass(eq=False)
class Element:
    """One element of the text. Offsets are bytes: `start` of '<', `stop` just behind its start tag's '>'."""

    tag: str
    attributes: dict[str, str]
    parent: Element | None
    start: int
    stop: int
    end: int = -1
    """Behind its end tag (or its own '/>')."""
    children: list[Element] = field(default_factory=list)
    changes: dict[str, str | None] = field(default_factory=dict)
    """Attribute to its new value; None takes it away."""
    renamed: str = ""

    def child(self, tag: str) -> Element | None:
        """The first child of that name."""
        return next((c for c in self.children if c.tag == tag), None)

    def walk(self) -> Iterator[Element]:
        """This element and all below it, in order."""
        yield self
        for child in self.children:
            yield from child.walk()

    def outside(self, tag: str) -> Iterator[Element]:
        """This element and all below it, in order, but for those of that tag and what is below these."""
        yield self
        for child in self.children:
            if child.tag != tag:
                yield from child.outside(tag)


class XmlText:
    """A parsed model file that can be written back with a few attributes changed. Raises ModelError for broken XML."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._inserted: dict[int, bytes] = {}
        self.root = self._parse()

    def named(self, section: str, name: str, tags: tuple[str, ...] = ()) -> Element | None:
        """The element of that name within a section ('worldbody', 'actuator'); None if it is not in this text."""
        for part in self.root.children:
            if part.tag == section:
                for element in part.walk():
                    if element.attributes.get("name") == name and (not tags or element.tag in tags):
                        return element
        return None

    def all(self, tag: str) -> list[Element]:
        """Every element of that tag."""
        return [e for e in self.root.walk() if e.tag == tag]

    def of_world(self, tag: str) -> list[Element]:
        """Elements of that tag which hang on the world of an MJCF itself, in no body, in their order."""
        inside = [e for part in self.root.children if part.tag == "worldbody" for e in part.outside("body")]
        return [e for e in inside if e.tag == tag]

    def change(self, element: Element, **attributes: str | None) -> None:
        """Sets attributes of one element; None takes one away."""
        element.changes.update(attributes)

    def set_last(self, tag: str, name: str, value: str) -> None:
        """One attribute of the last `tag` below the root, which counts; in a new one where there is none."""
        if there := [e for e in self.root.children if e.tag == tag]:
            self.change(there[-1], **{name: value})
        else:
            self.insert_first(self.root, f'<{tag} {name}="{value}"/>')

    def insert_first(self, parent: Element, line: str) -> None:
        """A new element as the first child of `parent`, on a line of its own."""
        if parent.stop == parent.end:
            raise ModelError(f"<{parent.tag}/> has no content to add to")
        first = parent.children[0] if parent.children else None
        indent = self._indent(first) if first else self._indent(parent) + b"  "
        self._insert(parent.stop, b"\n" + indent + line.encode())

    def insert_after(self, element: Element, line: str) -> None:
        """A new element behind `element`, on a line of its own."""
        self._insert(element.end, b"\n" + self._indent(element) + line.encode())

    def render(self) -> bytes:
        """The text with all changes."""
        pieces: list[tuple[int, int, bytes]] = [(at, at, new) for at, new in self._inserted.items()]
        for element in self.root.walk():
            if element.changes or element.renamed:
                pieces.append((element.start, element.stop, self._tag(element)))
        out, at = [], 0
        for start, stop, new in sorted(pieces, key=lambda p: p[:2]):
            out += [self._content[at:start], new]
            at = stop
        return b"".join([*out, self._content[at:]])

    def _insert(self, at: int, new: bytes) -> None:
        self._inserted[at] = self._inserted.get(at, b"") + new

    def _tag(self, element: Element) -> bytes:
        text = self._content[element.start : element.stop].decode()
        for name, value in element.changes.items():
            pattern = re.compile(rf"(\s+){re.escape(name)}\s*=\s*(\"[^\"]*\"|'[^']*')")
            found = pattern.search(text)
            if value is None:
                text = pattern.sub("", text, count=1)
            elif found:
                text = text[: found.start(2)] + quoteattr(value) + text[found.end(2) :]
            else:
                close = len(text) - (2 if text.endswith("/>") else 1)
                head, tail = text[:close].rstrip(), text[close:]
                text = f"{head} {name}={quoteattr(value)}{tail}"
        if element.renamed:
            if element.stop != element.end:
                raise ModelError(f"<{element.tag}> has content and cannot become <{element.renamed}>")
            text = f"<{element.renamed}" + text[1 + len(element.tag) :]
        return text.encode()

    def _indent(self, element: Element) -> bytes:
        line = self._content.rfind(b"\n", 0, element.start) + 1
        before = self._content[line : element.start]
        return before if not before.strip() else b" " * (len(before) - len(before.lstrip()))

    def _parse(self) -> Element:
        parser = expat.ParserCreate()
        stack: list[Element] = []
        roots: list[Element] = []

        def opened(tag: str, attributes: dict[str, str]) -> None:
            start = parser.CurrentByteIndex
            element = Element(tag, attributes, stack[-1] if stack else None, start, _tag_end(self._content, start))
            (stack[-1].children if stack else roots).append(element)
            stack.append(element)

        def closed(tag: str) -> None:
            element = stack.pop()
            empty = self._content[element.stop - 2 : element.stop] == b"/>"
            element.end = element.stop if empty else self._content.find(b">", parser.CurrentByteIndex) + 1

        parser.StartElementHandler, parser.EndElementHandler = opened, closed
        try:
            parser.Parse(self._content, True)
        except expat.ExpatError as error:
            raise ModelError(f"the model file is not sound XML: {error}") from None
        return roots[0]


def tag(name: str, attributes: Mapping[str, str | None]) -> str:
    """An element without children, as a line; attributes that are None are not in it."""
    return f"<{name} " + " ".join(f"{k}={quoteattr(v)}" for k, v in attributes.items() if v is not None) + "/>"


def number(value: float, digits: int = 9) -> str:
    """A value as MJCF holds it."""
    return format(float(value), f".{digits}g")


def numbers(values: Iterable[float], digits: int = 9) -> str:
    """Values as MJCF holds them."""
    return " ".join(number(v, digits) for v in values)


def with_includes(content: bytes, folder: Path) -> bytes:
    """An MJCF with the files that it includes in their places, as MuJoCo reads them; their comments too.

    Raises ModelError for one that is missing or includes itself.
    """
    deepest = 20  # includes in includes
    for _ in range(deepest):
        text = XmlText(content)
        included = text.all("include")
        if not included:
            return content
        for element in reversed(included):
            content = content[: element.start] + _inside(folder / element.attributes["file"]) + content[element.end :]
    raise ModelError(f"the files of '{folder}' include each other")


def _inside(path: Path) -> bytes:
    """What a file that is included holds: comments before its root, and the root's content."""
    content = files.content(path, ModelError)
    root = XmlText(content).root
    before = re.sub(rb"<\?.*?\?>|<!DOCTYPE[^>]*>|\xef\xbb\xbf", b"", content[: root.start]).strip()
    return before + content[root.stop : content.rfind(b"<", root.stop, root.end)]


def _tag_end(content: bytes, start: int) -> int:
    """The offset behind the '>' of a start tag; '>' within quotes does not count."""
    quote = b""
    for at in range(start, len(content)):
        c = content[at : at + 1]
        if quote:
            quote = b"" if c == quote else quote
        elif c in (b'"', b"'"):
            quote = c
        elif c == b">":
            return at + 1
    return len(content)
