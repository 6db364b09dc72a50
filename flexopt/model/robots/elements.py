"""XML with line numbers: a file in, a tree of `Element`s out; every fault names file, line and element.

Document type declarations are refused, so that a file can neither expand entities without end nor name other files.
"""

from __future__ import annotations

import math
import xml.parsers.expat
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from flexopt.errors import Fault, ModelError
from flexopt.foundation.arrays import Array
from flexopt.foundation.nearest import hint_or_list
from flexopt.foundation.reading import read_bounded

FILE_SIZE_MAX = 16_000_000
DEPTH_MAX = 200
ELEMENTS_MAX = 200_000
ATTRIBUTES_MAX = 200
# Far beyond any machine; products of a few such numbers stay finite. Smaller ones than 1 / NUMBER_MAX are 0, so that
# quotients stay finite, too.
NUMBER_MAX = 1e30


@dataclass
class Element:
    """One element: its tag, attributes and children, and where it stands."""

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list["Element"])

    @property
    def place(self) -> str:
        """File and line, as messages give them."""
        return f"{self.file}:{self.line}"

    @property
    def label(self) -> str:
        """The element in words: `joint 'elbow'`."""
        name = self.attributes.get("name")
        return cut(self.tag) if name is None else f"{cut(self.tag)} {cut(name)!r}"

    def all(self, *tags: str) -> Iterator[Element]:
        """The children of these tags, in the order of the file."""
        return (child for child in self.children if child.tag in tags)

    def first(self, tag: str) -> Element | None:
        """The first child of that tag."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """This element and all below it, in the order of the file."""
        stack: list[Element] = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))


class Faults:
    """Collects what is wrong with a robot description, with the numbers it reads."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.warnings: list[str] = []

    def add(self, element: Element, sentence: str, *, of: Element | None = None, value: str | None = None) -> None:
        """Note a fault of `element`, named as part of the element `of` where its own tag says too little."""
        self.faults.append(Fault(f"{element.place}: {_owner(element, of)}", sentence, value))

    def warn(self, element: Element, sentence: str, *, of: Element | None = None) -> None:
        """Note what is readable but odd."""
        self.warnings.append(f"{element.place}: {_owner(element, of)}: {sentence}")

    def numbers(
        self,
        element: Element,
        key: str,
        count: int | Sequence[int],
        stand_in: Sequence[float],
        of: Element | None = None,
    ) -> Array:
        """The attribute's numbers, separated by spaces; the stand-in where it is absent or faulty."""
        text = element.attributes.get(key)
        default = np.array(stand_in, dtype=float)
        if text is None:
            return default
        counts = (count,) if isinstance(count, int) else tuple(count)
        words = text.split()
        values = [_number(word) for word in words]
        owner = _owner(element, of)
        if len(words) not in counts:
            wanted = " or ".join(map(str, counts))
            sentence = f"needs {wanted} number{'s' if counts != (1,) else ''} separated by spaces, not {len(words)}"
            self.faults.append(Fault(f"{element.place}: {owner} {key}", sentence, cut(text)))
            return default
        numbers = [value for value in values if value is not None]
        if len(numbers) < len(values):
            wrong = next(word for word, value in zip(words, values, strict=True) if value is None)
            sentence = f"{cut(wrong)!r} is no number between ±{NUMBER_MAX:g}"
            self.faults.append(Fault(f"{element.place}: {owner} {key}", sentence, cut(text)))
            return default
        return np.array(numbers)

    def number(self, element: Element, key: str, stand_in: float = 0.0, of: Element | None = None) -> float:
        """As `numbers`, for one."""
        return float(self.numbers(element, key, 1, (stand_in,), of)[0])

    def required(self, element: Element, key: str, of: Element | None = None) -> str:
        """The attribute's text, or a fault and the empty text."""
        text = element.attributes.get(key, "").strip()
        if not text:
            self.add(element, f"needs the attribute {key}", of=of)
        return text


def parse(path: Path, name: str) -> Element:
    """The root element of an XML file; `name` is what messages call it.

    Raises:
        ModelError: the file cannot be read, is no well-formed XML, or has a document type declaration.
    """
    try:
        content = read_bounded(path, FILE_SIZE_MAX)
    except OSError as error:
        raise ModelError(f"{name}: cannot be read ({error.strerror or error})") from None
    return parse_bytes(content, name)


def parse_bytes(content: bytes, name: str) -> Element:
    """As `parse`, for the bytes of a file."""
    parser = xml.parsers.expat.ParserCreate()
    open_elements: list[Element] = []
    roots: list[Element] = []
    count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > ELEMENTS_MAX:
            raise ModelError(f"{name}: has more than {ELEMENTS_MAX} elements; this is no robot description")
        if len(attributes) > ATTRIBUTES_MAX:
            place = f"{name}:{parser.CurrentLineNumber}"
            raise ModelError(f"{place}: an element has {len(attributes)} attributes; at most {ATTRIBUTES_MAX} are read")
        element = Element(tag, attributes, name, parser.CurrentLineNumber)
        if open_elements:
            open_elements[-1].children.append(element)
        else:
            roots.append(element)
        if len(open_elements) >= DEPTH_MAX:
            raise ModelError(f"{element.place}: elements are nested more than {DEPTH_MAX} deep")
        open_elements.append(element)

    def end(_tag: str) -> None:
        open_elements.pop()

    def doctype(*_: object) -> None:
        raise ModelError(f"{name}:{parser.CurrentLineNumber}: a document type declaration (DOCTYPE) is refused")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(content, True)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.errors.messages[error.code]
        raise ModelError(f"{name}:{error.lineno}: is not well-formed XML: {reason}") from None
    except ModelError:
        raise
    except (LookupError, ValueError) as error:
        raise ModelError(f"{name}: cannot be decoded: {error}") from None
    return roots[0]


def check_text(faults: Faults, element: Element, key: str, choices: Sequence[str], stand_in: str) -> str:
    """One of a few words."""
    text = element.attributes.get(key, stand_in)
    if text not in choices:
        faults.add(element, f"{key} must be {' or '.join(choices)}", value=repr(cut(text)))
        return stand_in
    return text


def there_are(word: str, valid: Iterable[str]) -> str:
    """The end of a sentence about a word that the file does not have."""
    return hint_or_list(word, valid, "there are ", 12)


def unique(faults: Faults, elements: Sequence[Element], what: str, name: Callable[[Element], str]) -> None:
    """A fault for each element whose name an earlier one has."""
    seen: dict[str, Element] = {}
    for element in elements:
        key = name(element)
        if key and key in seen:
            faults.add(element, f"the name is taken by the {what} of line {seen[key].line}; names must differ")
        seen.setdefault(key, element)


def _owner(element: Element, of: Element | None) -> str:
    return element.label if of is None else f"{of.label} <{element.tag}>"


def _number(word: str) -> float | None:
    """The number, if it is one that can be worked with; Python's own 1_000 is none in these files."""
    try:
        value = float(word) if "_" not in word else math.nan
    except ValueError:
        return None
    if not abs(value) <= NUMBER_MAX:
        return None
    return value if abs(value) * NUMBER_MAX >= 1 else 0.0


def cut(text: str) -> str:
    """A text as messages quote it."""
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."
