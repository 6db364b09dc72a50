"""What a robot file may say: the tables of known elements and attributes, and the check of a file against them.

In: the elements of a file. Out: the same without what is not read, with a fault for each word that the format does not
have, and the nearest it has. What the format's readers leave out (a simulator's elements, macros) is one warning.
The tables are the files `formats/urdf.txt` and `formats/mjcf.txt`, which tell their own layout.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files

from flexopt.errors import Fault, ModelError
from flexopt.foundation.nearest import nearest
from flexopt.model.robots.elements import Element, Faults, cut, there_are

# How much a foreign element below <robot> must look like one of URDF to be a misspelt one.
MISSPELT = 0.75
# The word of the machine file's `ignore` that turns these faults into warnings.
UNKNOWN = "unknown"
UNKNOWN_MAX = 1000
LIFT = f'; ignore = ["{UNKNOWN}"] in the machine file reads the robot without'


@dataclass(frozen=True, eq=False)
class Known:
    """An element of a format.

    Attributes:
        attributes: names of those it has.
        children: elements that it may contain.
        foreign: attributes and elements known from files in use that mean nothing in the format.
        read: whether flexopt reads it.
    """

    read: bool = True
    attributes: set[str] = field(default_factory=set[str])
    children: dict[str, Known] = field(default_factory=dict[str, "Known"])
    foreign: set[str] = field(default_factory=set[str])


@cache
def known_elements(name: str) -> Known:
    """The root element of the format `"urdf"` or `"mjcf"`, from its table."""
    text = files("flexopt.model.robots").joinpath("formats", f"{name}.txt").read_text(encoding="utf-8")
    groups: dict[str, list[str]] = {}
    columns: dict[str, Known] = {}
    borrowed: list[tuple[Known, str]] = []
    open_elements: list[Known] = []
    for line in text.splitlines():
        words = line.split()
        if not words or words[0] == "#":
            continue
        head, rest = words[0], words[1:]
        if head.startswith("%"):
            groups[head] = rest
            continue
        if head == "|":
            _extend(open_elements[-1], rest, groups)
            continue
        del open_elements[(len(line) - len(line.lstrip())) // 2 :]
        parent = open_elements[-1] if open_elements else None
        tag = head.lstrip("-&~")
        if head.startswith("~") and parent is not None:
            parent.foreign.add(tag)
            continue
        element = Known(read=not head.startswith("-"))
        borrowed += [(element, word) for word in ([tag] if "&" in head else []) + [w for w in rest if w[0] == "<"]]
        _extend(element, [word for word in rest if word[0] != "<"], groups)
        open_elements.append(element)
        (columns if parent is None else parent.children)[tag] = element
    for element, source in borrowed:
        other = columns[source.lstrip("<")]
        element.children.update(other.children)
        if not source.startswith("<"):
            element.attributes.update(other.attributes)
            element.foreign.update(other.foreign)
    return columns["robot" if name == "urdf" else "mujoco"]


def _extend(element: Known, words: list[str], groups: dict[str, list[str]]) -> None:
    for word in words:
        if word.startswith("~"):
            element.foreign.add(word[1:])
        else:
            element.attributes.update(groups.get(word, [word]))


class _Check:
    def __init__(self, faults: Faults, *, strict: bool, namespaces: bool) -> None:
        self.faults = faults
        self.strict = strict
        self.namespaces = namespaces
        self.foreign = defaultdict[str, list[str]](list)
        self.count = 0

    def element(self, element: Element, known: Known, parent: Element | None = None, *, read: bool) -> Element:
        """The element with what the format knows of it."""
        owner = element.label
        if parent is not None and "name" not in element.attributes:
            owner = f"{parent.label} <{element.tag}>"
        read = read and known.read
        attributes: dict[str, str] = {}
        for key, text in element.attributes.items():
            name = key
            if self._is_foreign(key, known):
                if not key.startswith("xmlns"):
                    self.foreign[f"{element.tag} {key}"].append(element.place)
                continue
            if key not in known.attributes:
                name = self._unknown(
                    element, owner, f"attribute {key!r}", known.attributes - {*element.attributes}, read
                )
            if name:
                attributes[name] = text
        children = [self._child(element, owner, child, known, read) for child in element.children]
        kept = [child for child in children if child is not None]
        return replace(element, attributes=attributes, children=kept)

    def _child(self, element: Element, owner: str, child: Element, known: Known, read: bool) -> Element | None:
        if self._is_foreign(child.tag, known):
            self.foreign[f"<{child.tag}>"].append(child.place)
            return None
        tag = child.tag
        if tag not in known.children:
            tag = self._unknown(child, owner, f"element <{tag}>", set(known.children), read)
            if not tag:
                return None
            child = replace(child, tag=tag)
        return self.element(child, known.children[tag], element, read=read)

    def _is_foreign(self, word: str, known: Known) -> bool:
        return word in known.foreign or (self.namespaces and (":" in word or word == "xmlns"))

    def _unknown(self, element: Element, owner: str, what: str, valid: set[str], read: bool) -> str:
        """Note it; the word that was meant, with which the rest is read, or none."""
        self.count += 1
        if self.count > UNKNOWN_MAX:
            raise ModelError(f"{element.file}: has more than {UNKNOWN_MAX} words that are unknown to its format")
        word = what.split()[1].strip("'<>")
        hint = there_are(word, sorted(valid))
        if read and self.strict:
            self.faults.faults.append(Fault(f"{element.place}: {owner}", f"unknown {cut(what)}{hint}{LIFT}"))
            return nearest(word, sorted(valid)) or ""
        self.faults.warnings.append(f"{element.place}: {owner}: unknown {cut(what)} is left out{hint}")
        return ""


def check_known(root: Element, name: str, faults: Faults, *, strict: bool = True) -> Element:
    """The file's elements as its format knows them; unknown ones are faults, or warnings where they are not read.

    A misspelt word is read on as what it was meant as, so that nothing that follows from it is a fault beside it.

    Args:
        root: the root element, <robot> or <mujoco>, included files in place.
        name: the format, `"urdf"` or `"mjcf"`.
        faults: takes faults and warnings.
        strict: whether unknown words are faults at all, or only warnings.
    """
    check = _Check(faults, strict=strict, namespaces=name == "urdf")
    known = known_elements(name)
    if name == "urdf":
        root = _without_foreign(root, known, check.foreign)
    checked = check.element(root, known, read=True)
    if check.foreign:
        listed = ", ".join(f"{word} ({_places(places, root.file)})" for word, places in check.foreign.items())
        faults.warnings.insert(0, f"{root.file}: left out, as not part of the format: {listed}")
    return checked


def _places(places: list[str], file: str) -> str:
    """How many there are, and where the first stands; of the file itself the line."""
    first = places[0].replace(f"{file}:", "line ", 1)
    return f"1, {first}" if len(places) == 1 else f"{len(places)}, from {first}"


def _without_foreign(root: Element, known: Known, foreign: defaultdict[str, list[str]]) -> Element:
    """Without what stands below <robot> for other programs; what looks like a misspelt element of URDF stays."""
    kept: list[Element] = []
    for child in root.children:
        if child.tag in known.children or nearest(child.tag, sorted(known.children), MISSPELT):
            kept.append(child)
        else:
            foreign[f"<{child.tag}>"].append(child.place)
    return replace(root, children=kept)
