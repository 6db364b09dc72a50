"""The known word that was probably meant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

# How alike two words must be for one to be suggested for the other.
ALIKE = 0.65
# Longer words are neither compared, which takes the product of their lengths, nor listed.
WORD_MAX = 200


def nearest(word: str, known: Iterable[str], alike: float = ALIKE) -> str | None:
    """The one of `known` that is most like `word`, if any is at all.

    Of a dotted name that which has all its parts, in whatever order, and the fewest others.
    """
    words, given = [each for each in known if len(word) <= WORD_MAX >= len(each)], set(word.split("."))
    holding = [each for each in words if "." in word and given <= set(each.split("."))]
    if holding:
        return min(holding, key=lambda each: (len(set(each.split("."))), each.count(".")))
    likeness = [_likeness(word, each) for each in words]
    most = max(likeness, default=0.0)
    return words[likeness.index(most)] if most >= alike else None


def _likeness(word: str, other: str) -> float:
    """From 0 to 1, of the parts that one of two dotted names has alone: one owner makes no quantities alike."""
    import difflib  # noqa: PLC0415  (which only faults need)

    given, has = word.split("."), other.split(".")
    apart = [part for part in given if part not in has], [part for part in has if part not in given]
    left, right = apart if all(apart) else (given, has)
    return difflib.SequenceMatcher(None, ".".join(left), ".".join(right)).ratio()


def hint_or_list(word: str, known: Iterable[str], heading: str = "valid here: ", most: int | None = None) -> str:
    """As `hint`, with the known words themselves, or so many of them, where none is near."""
    words = [each for each in known if len(each) <= WORD_MAX]
    some = words if most is None or len(words) <= most else _of_each_kind(words, most)
    listed = ", ".join(some) + ("" if some is words else ", …")
    return hint(word, words, f"; {heading}{listed}" if words else "")


def _of_each_kind(words: Sequence[str], most: int) -> list[str]:
    """So many of the words, in their order: those without dots, and such that parts of many of them are each in one."""
    counts = Counter(part for each in words for part in each.split("."))
    left, chosen, shown = list(words), list[str](), set[str]()
    while len(chosen) < most:
        best = max(left, key=lambda each: ("." not in each, sum(counts[part] for part in {*each.split(".")} - shown)))
        left.remove(best)
        chosen.append(best)
        shown |= {*best.split(".")} if "." in best else set()
    return [each for each in words if each in chosen]


def hint(word: str, known: Iterable[str], otherwise: str = "") -> str:
    """The end of a sentence about a word that is not known: the nearest known one, or else `otherwise`."""
    near = nearest(word, known)
    return otherwise if near is None else f"; did you mean {near!r}?"
