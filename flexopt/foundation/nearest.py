"""The known word that was probably meant."""

from __future__ import annotations

from collections.abc import Iterable

# How alike two words must be for one to be suggested for the other.
ALIKE = 0.65


def nearest(word: str, known: Iterable[str], alike: float = ALIKE) -> str | None:
    """The one of `known` that is most like `word`, if any is at all."""
    import difflib  # noqa: PLC0415  (which only faults need)

    words, parts = list(known), sorted(word.split("."))
    # The same parts of a dotted name in another order are nearer than any other word.
    turned = next((each for each in words if "." in word and sorted(each.split(".")) == parts), None)
    return turned or next(iter(difflib.get_close_matches(word, words, n=1, cutoff=alike)), None)


def hint_or_list(word: str, known: Iterable[str], heading: str = "valid here: ", most: int | None = None) -> str:
    """As `hint`, with the known words themselves, or the first of them, where none is near."""
    words = list(known)
    listed = ", ".join(words[:most]) + ("" if most is None or len(words) <= most else ", …")
    return hint(word, words, f"; {heading}{listed}" if words else "")


def hint(word: str, known: Iterable[str], otherwise: str = "") -> str:
    """The end of a sentence about a word that is not known: the nearest known one, or else `otherwise`."""
    near = nearest(word, known)
    return otherwise if near is None else f"; did you mean {near!r}?"
