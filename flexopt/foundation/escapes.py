r"""Names as text of each target: Matplotlib's mathtext, C, XML and HTML, the terminal, lists that options take.

In: a name as a user wrote it, any Unicode at all. Out: text that the target shows as it is, and never reads as more.
A machine may be called `rig $x_{$`, `???/` or `掘削機-2`; whoever puts a name into a text takes it through here.
"""

from __future__ import annotations

import codecs
import csv
import io
import json
import re
import unicodedata
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from typing import Any, cast

# Letters whose ASCII the Unicode tables do not tell.
_SPELLED = {
    "−": "-", "–": "-", "—": "-", "‐": "-", "‑": "-", "·": "*", "×": "x", "÷": "/", "≤": "<=", "≥": ">=", "≠": "!=",
    "±": "+-", "∞": "inf", "→": "->", "←": "<-", "‖": "||", "∂": "d", "√": "sqrt", "∫": "int", "∈": "in", "∝": "~",
    "∘": "o", "°": "deg", "′": "'", "″": '"', "‘": "'", "’": "'", "“": '"', "”": '"', "„": '"', "ß": "ss", "ø": "o",
    "Ø": "O", "æ": "ae", "Æ": "AE", "µ": "u", "≈": "~", "✓": "ok", "⁄": "/", "⟨": "<", "⟩": ">",
    "∑": "sum", "∏": "prod", "∇": "grad", "≪": "<<", "≫": ">>", "∩": "and", "∪": "or", "∀": "all", "⇒": "=>",
    "↔": "<->",
}  # fmt: skip
TERMINAL = "flexopt.terminal"
# What stands where a font has no letter.
_NO_GLYPH = "\N{WHITE SQUARE}"
# Looks like a backslash, and is none to mathtext.
_BACKSLASH = "\N{SET MINUS}"
_HALF = re.compile("[\ud800-\udfff]")
# More letters leave a picture no room: of a name, of one of several in a legend, of a whole title.
PICTURE_MAX, LEGEND_MAX, TITLE_MAX = 40, 16, 100


def one_line(text: str) -> str:
    """Text on one line: without control characters, halves of pairs, and marks that turn the direction of writing."""
    kept = (" " if unicodedata.category(c) in ("Cc", "Cs", "Cn", "Zl", "Zp") else c for c in text)
    return "".join(c for c in kept if unicodedata.category(c) != "Cf")


def mathtext(text: str, most: int = PICTURE_MAX) -> str:
    r"""Text in a picture, cut where it is long: a dollar sign is `\$`, and a letter that no font has is a square."""
    found = one_line(text)
    found = found if len(found) <= most else found[: most - 1] + "…"
    if not found.isascii():
        known = _glyphs()
        found = "".join(c if c.isascii() or ord(c) in known else _NO_GLYPH for c in found)
    # A backslash before a dollar sign would take away the one put there.
    return re.sub(r"\\+(?=\$|$)", lambda m: _BACKSLASH * len(m[0]), found).replace("$", r"\$")


def c_text(text: str) -> str:
    """Text inside a C string or comment: ASCII on one line, no end of either, no trigraph, no line that goes on."""
    plain = "".join(c if c.isprintable() and c not in '"\\' else " " for c in one_line(text))
    plain = ascii_text(plain, unknown="_").replace('"', "'").replace("\\", " ")
    return re.sub(r"\?(?=\?)", "? ", re.sub(r"\*(?=/)|/(?=\*)", lambda m: f"{m[0]} ", plain))


def c_identifier(text: str) -> str:
    """A name in lower case that C takes: letters, digits and single underscores."""
    word = re.sub(r"[^a-z0-9]+", "_", ascii_text(one_line(text), unknown="_").lower()).strip("_")
    return word if word[:1].isalpha() else f"machine_{word}".rstrip("_")


def markup(text: str) -> str:
    """Text inside XML or HTML, in an attribute or between tags."""
    from html import escape  # noqa: PLC0415  (its table of names is large, and few texts are HTML)

    return escape(one_line(text))


def terminal(text: str) -> str:
    """Text of several lines for a terminal: nothing in it moves the cursor, colours or turns the direction.

    Halves of pairs, as which Python reads bytes of a path that the locale cannot, are spelled as where it is quoted.
    """
    spelled = _HALF.sub(lambda m: repr(m[0])[1:-1], text)
    return "\n".join(one_line(line.replace("\t", "    ")) for line in spelled.split("\n"))


def ascii_text(text: str, unknown: str | None = None) -> str:
    r"""Text in ASCII: Greek letters by their names, ᵀ as ^T, ₁ as _1; other letters as `unknown`, or as \uXXXX."""
    return "".join(c if c.isascii() else _spelled(c, unknown) for c in text)


def _spelled(letter: str, unknown: str | None) -> str:
    if letter in _SPELLED:
        return _SPELLED[letter]
    if unicodedata.combining(letter):
        return ""
    name = unicodedata.name(letter, "").replace("LAMDA", "LAMBDA").split()
    if len(name) == 4 and name[0] == "GREEK" and name[2] == "LETTER":
        return name[3].lower() if name[1] == "SMALL" else name[3].capitalize()
    kind, *codes = unicodedata.decomposition(letter).split() or [""]
    if kind in ("<super>", "<sub>"):
        return ("^" if kind == "<super>" else "_") + ascii_text("".join(chr(int(c, 16)) for c in codes), unknown)
    parts = unicodedata.normalize("NFKD", letter)
    if parts != letter:
        return ascii_text(parts, unknown)
    return letter.encode("ascii", "backslashreplace").decode() if unknown is None else unknown


def _for_terminal(error: UnicodeError) -> tuple[str, int]:
    """The error handler `TERMINAL`: letters that a terminal's code page lacks, as `ascii_text`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return ascii_text(error.object[error.start : error.end]), error.end


codecs.register_error(TERMINAL, _for_terminal)


def _glyphs() -> frozenset[int]:
    """Letters that the fonts of pictures have."""
    from flexopt.foundation.matplotlib_apart import matplotlib  # noqa: PLC0415  (only pictures need it)

    settings = cast(dict[str, list[str]], matplotlib.rcParams)
    families = settings["font.family"]
    return _glyphs_of(tuple(name for family in families for name in settings.get(f"font.{family}", [family])))


@cache
def _glyphs_of(names: tuple[str, ...]) -> frozenset[int]:
    font_manager: Any = import_module("matplotlib.font_manager")  # only pictures need it
    installed = {font.name for font in font_manager.fontManager.ttflist}
    paths = {str(font_manager.findfont(name)) for name in names if name in installed}
    found: set[int] = set()
    for path in paths or {str(font_manager.findfont("DejaVu Sans"))}:
        found |= set(font_manager.get_font(path).get_charmap())
    return frozenset(found)


def option_list(names: Iterable[str]) -> str:
    """Names with commas between them, as options take them: in double quotes where one has a comma itself."""
    row = io.StringIO()
    csv.writer(row, lineterminator="").writerow(names)
    return row.getvalue()


def of_option_list(text: str) -> list[str]:
    """The names in what `option_list` writes, without blanks around them."""
    rows = csv.reader([" ".join(text.splitlines())], skipinitialspace=True)
    return [name.strip() for row in rows for name in row] or [""]


def toml_key(name: str) -> str:
    """A name as a key of TOML: quoted where it is none by itself."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(one_line(name), ensure_ascii=False)
