"""Mutations of files and values: of bytes, of words and numbers in text, and of the structure that the text stands for.

Every choice is drawn from the `random.Random` that is given, so that an input can be made again.
"""

from __future__ import annotations

import contextlib
import copy
import json
import math
import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree as ET

# A page that lets this through runs it.
SCRIPT = "</script><script>FUZZ()</script>"
NAMES = (
    "", " ", "'", '"', "a\nb", "a\rb", SCRIPT, "<b>&amp;", "../../x", "/etc/passwd", "a\0b", "\u202eabc", "ü" * 40, "a.b",
    "x" * 300, "x" * 100_000, "𝔘𝔫𝔦", "\x1b[31mred\x1b[0m", "a\tb", "%s%n", "{0}{{", "${HOME}", "`id`", "$(id)", "*/", "\\",
    "--json", "-1", "nan", "base.x", "CON", "a;b", "a,b", "=1+1", "\ufeffa", "#a", "None", "1e5", "true", "\u2028", "\x7f",
)  # fmt: skip
NUMBERS = (
    0, -1, 1, -0.0, 0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 1.7976931348623157e308, 5e-324, 1e-300, 1e-12, 1e-6,
    1e6, 1e9, 1e12, 1e15, 1e16, -1e-9, 2**31, 2**53, 2**63, -(2**63), 2**64, 10**400, -(10**400), math.pi, -math.pi, 1e-3,
)  # fmt: skip
NUMBER_WORDS = (
    "1e400", "-1e400", "1" + "0" * 400, "1" + "0" * 5000, "nan", "NaN", "inf", "-Infinity", "0x10", "1_000", "1,5", "1e", "--1",
    "١٢", "１", "1e-400", "0" * 5000 + "1", "0." + "1" * 5000, "true", "None", "[]", "{}", "", "1979-05-27", "1e999999999",
)  # fmt: skip
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")
QUOTED = re.compile(r'"[^"\n]*"')
WORD = re.compile(r"[A-Za-z_]\w+")
# Past what any reader may go, and soon written.
DEEP = 20_000
TEXT_MAX = 80_000


def number(rng: Random, old: Any = 1.0) -> Any:
    """Another number: an edge of what doubles and integers hold, or the old one by some orders of magnitude."""
    usable = isinstance(old, int | float) and not isinstance(old, bool) and abs(old) < 1e300 and math.isfinite(old)
    if not usable or rng.random() < 0.4:
        return rng.choice(NUMBERS)
    way = rng.randrange(5)
    factor = (
        10 ** rng.uniform(-12, 12),
        10 ** rng.randint(-4, 4),
        rng.uniform(0.5, 2),
        -1,
        1 + rng.uniform(-1e-9, 1e-9),
    )
    found = old * factor[way]
    return round(found) if isinstance(old, int) and rng.random() < 0.5 else found


def deep(rng: Random, depth: int = 200) -> Any:
    """A value in many lists or tables."""
    found: Any = rng.choice((1.0, "x"))
    for _ in range(rng.choice((5, 30, depth))):
        found = [found] if rng.random() < 0.5 else {"x": found}
    return found


def value(rng: Random, old: Any) -> Any:
    """Something in the place of an old value, mostly of its type."""
    if rng.random() < 0.6:
        if isinstance(old, bool):
            return not old
        if isinstance(old, int | float):
            return number(rng, old)
        if isinstance(old, str):
            return rng.choice(NAMES)
    others: tuple[Callable[[], Any], ...] = (
        lambda: number(rng), lambda: rng.choice(NAMES), lambda: True, list, dict, lambda: [old], lambda: {"x": old},
        lambda: [old] * times(rng, old), lambda: deep(rng), lambda: str(old), lambda: [[1.0], [2.0, 3.0]],
        lambda: [number(rng) for _ in range(3)],
    )  # fmt: skip
    return rng.choice(others)()


def times(rng: Random, old: Any) -> int:
    """How often a value is repeated: what is large already, not a thousand times more."""
    return min(rng.choice((1, 2, 3, 7, 1000)), 1 + 5000 // (1 + len(_places(old))))


def structure(rng: Random, data: Any) -> Any:
    """Copy tables and lists, with one place changed."""
    found = _copied(data)
    inner, key = rng.choice(_places(found) or [(None, None)])
    if inner is None:
        return value(rng, found)
    way = rng.randrange(8)
    if way == 0:
        del inner[key]
    elif way == 1 and isinstance(inner, dict):
        new = rng.choice((str(key) + "x", str(key)[:-1], str(key).upper(), rng.choice(NAMES)))
        inner[new] = inner.pop(key)
    elif way == 2 and isinstance(inner, list):
        inner.extend([_copied(inner[key])] * times(rng, inner[key]))
    elif way == 3:
        other, place = rng.choice(_places(found))
        inner[key] = _copied(other[place])
    elif way == 4 and isinstance(inner, list):
        rng.shuffle(inner)
    else:
        inner[key] = value(rng, inner[key])
    return found


def _copied(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _copied(inner) for key, inner in data.items()}
    return [_copied(inner) for inner in data] if isinstance(data, list | tuple) else data


def _places(data: Any) -> list[tuple[Any, Any]]:
    """Every place of a value: what holds it, and its key there."""
    found, waiting = list[tuple[Any, Any]](), [data]
    while waiting:
        inner = waiting.pop()
        keys = list(inner) if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else []
        found += [(inner, key) for key in keys]
        waiting += [inner[key] for key in keys]
    return found


def toml(data: Any) -> str:
    """Tables as TOML, inline below the first level."""
    return (
        "".join(f"{json.dumps(key)} = {_inline(inner)}\n" for key, inner in data.items())
        if isinstance(data, dict)
        else ""
    )


def _inline(data: Any) -> str:
    if isinstance(data, dict):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_inline(inner)}" for key, inner in data.items()) + "}"
    if isinstance(data, list):
        return "[" + ", ".join(map(_inline, data)) + "]"
    if isinstance(data, bool | str):
        return json.dumps(data)
    return str(data) if isinstance(data, int | float) else json.dumps(str(data))


def xml(rng: Random, text: str) -> str:
    """One change of an element or an attribute."""
    root = ET.fromstring(text)
    parents = [element for element in root.iter() if len(element)]
    element = rng.choice(list(root.iter()))
    way = rng.randrange(7)
    if way == 0 and parents:
        parent = rng.choice(parents)
        parent.remove(rng.choice(list(parent)))
    elif way == 1 and parents:
        parent = rng.choice(parents)
        parent.append(copy.deepcopy(rng.choice(list(rng.choice(parents)))))
    elif way == 2:
        element.tag = rng.choice((element.tag + "x", "robot", "mujoco", "link", "joint", "include", "default", "body"))
    elif way == 3:
        element.append(ET.Element("include", {"file": rng.choice(("main.xml", "/dev/zero", "../x.xml", "."))}))
    elif element.attrib:
        name = rng.choice(list(element.attrib))
        if way == 4:
            del element.attrib[name]
        elif NUMBER.search(element.attrib[name]) and rng.random() < 0.7:
            element.attrib[name] = _number_in(rng, element.attrib[name])
        else:
            element.attrib[name] = _of_xml(rng.choice((*NAMES, *NUMBER_WORDS)))
    return ET.tostring(root, encoding="unicode")


def _of_xml(text: str) -> str:
    return re.sub(r"[\0-\x08\x0b\x0c\x0e-\x1f]", "", text)


BOMB = '<!DOCTYPE r [<!ENTITY a0 "ha">' + "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12)) + "]>"


def hostile_xml(rng: Random, text: str) -> str:
    """Bombs of entities, files from elsewhere, endless nesting."""
    body = re.sub(r"<\?xml[^>]*\?>", "", text)
    way = rng.randrange(6)
    if way == 0:
        return BOMB + body.replace('name="', 'name="&a12;', 1)
    if way == 1:
        return '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>' + body.replace('name="', 'name="&x;', 1)
    if way == 2:
        return "<robot>" * DEEP + "</robot>" * DEEP
    if way == 3:
        return body.replace(">", ">" + "<body>" * DEEP + "</body>" * DEEP, 1)
    if way == 4:
        return f'<?xml version="1.0" encoding="{rng.choice(("utf-16", "rot13", "idna", "x", "latin-1"))}"?>' + body
    return '<!DOCTYPE r [<!ENTITY big "' + "A" * 100_000 + '">]>' + body.replace('name="', 'name="' + "&big;" * 2000, 1)


def _number_in(rng: Random, text: str) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text + " " + rng.choice(NUMBER_WORDS)
    hit = rng.choice(found)
    new = rng.choice(NUMBER_WORDS) if rng.random() < 0.25 else _spelt(number(rng, float(hit[0])))
    return text[: hit.start()] + new + text[hit.end() :]


def _spelt(given: Any) -> str:
    return str(given) if isinstance(given, float) or abs(given) < 10**400 else "1" + "0" * 400


def words(rng: Random, text: str) -> str:
    """One number, name, word or line of a text changed."""
    way = rng.randrange(8)
    lines = text.splitlines(keepends=True)
    if way <= 2:
        return _number_in(rng, text)
    pattern = QUOTED if way == 3 else WORD
    found = list(pattern.finditer(text))
    if way <= 4 and found:
        hit = rng.choice(found)
        new = rng.choice((hit[0] + "x", hit[0][:-1], rng.choice(NAMES)))
        return text[: hit.start()] + (json.dumps(new) if way == 3 else new) + text[hit.end() :]
    if not lines:
        return rng.choice(NAMES)
    k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    if way == 5:
        del lines[k]
    elif way == 6:
        lines.insert(k, lines[j])
    else:
        lines[k], lines[j] = lines[j], lines[k]
    return "".join(lines)


def scaled(rng: Random, text: str) -> str:
    """A few numbers of a text larger, smaller or of the other sign: mostly what still can be computed."""
    for _ in range(rng.choice((1, 2, 4))):
        found = list(NUMBER.finditer(text))
        if found:
            hit = rng.choice(found)
            factor = rng.choice(
                (10 ** rng.uniform(-9, 9), 10 ** rng.uniform(-2, 2), rng.choice((-1.0, 0.0)), 1 + 1e-12)
            )
            text = text[: hit.start()] + repr(float(hit[0]) * factor) + text[hit.end() :]
    return text


def letters(rng: Random, content: bytes) -> bytes:
    """Bytes flipped, cut, doubled, or in another encoding."""
    k, j = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    text = content.decode("utf-8", "replace")
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: content[:k],
        lambda: content[:k] + content[j:],
        lambda: content[:j] + content[k:j] * rng.choice((1, 3, 100)) + content[j:],
        lambda: content[:k] + rng.randbytes(rng.choice((1, 2, 16))) + content[k:],
        lambda: content[:k] + bytes([rng.randrange(256)]) + content[k + 1 :],
        lambda: content[:k] + b"\0" + content[k:],
        lambda: b"\xef\xbb\xbf" + content,
        lambda: text.encode("utf-16"),
        lambda: text.encode("utf-32"),
        lambda: text.encode("latin-1", "replace"),
        lambda: content.replace(b"\n", b"\r\n"),
        lambda: content.replace(b"\n", b"\r"),
        lambda: content[:k] + "  \u200bé".encode() + content[k:],
        lambda: b"",
        lambda: rng.randbytes(rng.choice((1, 100, 10_000))),
        lambda: content * 50,
        lambda: b"[" * 100_000,
        lambda: b'{"a":' * 50_000,
        lambda: b"a." * 50_000 + b"a = 1\n",
        lambda: b"x" * 2_000_000,
        lambda: content[::-1],
    )
    return rng.choice(ways)()


def text_of(rng: Random, path: Path, content: bytes) -> bytes:
    """One mutation of a text file, by its structure where it has one."""
    if len(content) > TEXT_MAX:
        raise ValueError("too long for a reader without limits, which these are")
    suffix = path.suffix.lower()
    text = content.decode("utf-8")
    if rng.random() < 0.45:
        return words(rng, text).encode("utf-8", "surrogatepass")
    if suffix == ".toml":
        return toml(structure(rng, tomllib.loads(text))).encode("utf-8", "surrogatepass")
    if suffix == ".json":
        return json.dumps(structure(rng, json.loads(text))).encode("utf-8", "surrogatepass")
    if suffix in {".xml", ".urdf", ".dae"}:
        return (hostile_xml if rng.random() < 0.15 else xml)(rng, text).encode("utf-8", "surrogatepass")
    return words(rng, text).encode("utf-8", "surrogatepass")


def content_of(rng: Random, path: Path, content: bytes) -> bytes:
    """One to three mutations of a file's content."""
    if rng.random() < 0.3 and len(content) < TEXT_MAX:
        with contextlib.suppress(UnicodeDecodeError):
            return scaled(rng, content.decode("utf-8")).encode()
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        try:
            content = letters(rng, content) if rng.random() < 0.2 else text_of(rng, path, content)
        except (ValueError, RecursionError, ET.ParseError, AttributeError, TypeError, KeyError, OverflowError):
            content = letters(rng, content)  # no text, or no longer of its kind
    return content


def in_place_of(rng: Random, path: Path) -> str:
    """Something else than a file where a file was; its name."""
    ways = ["missing", "folder", "itself", "hole"]
    ways += ["pipe", "endless", "nothing", "terminal"] if hasattr(os, "mkfifo") else []
    way = rng.choice(ways)
    path.unlink()
    if way == "folder":
        path.mkdir()
    elif way == "itself":
        path.symlink_to(path.name)
    elif way == "hole":  # 4 GB of zeros that take no room
        with path.open("wb") as file:
            file.truncate(2**32)
    elif way == "pipe":
        os.mkfifo(path)
    elif way in {"endless", "nothing", "terminal"}:
        path.symlink_to({"endless": "/dev/zero", "nothing": "/dev/null", "terminal": "/dev/tty"}[way])
    return way
