"""Straight-line functions of generated code in which multiplications and the additions after them are one operation.

In: the text of one function as CasADi writes it for an SX graph, a statement a line. Out: the same with `fma`, `fms`
(x y − z) and `fnma` (z − x y) where they can be, and `shared_quotient` where several numbers are divided by one, each
result in a variable of its own. What compilers fuse depends on how many lanes they work with; chosen here, kernels of
any width, by any compiler, give the same bits.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

HEAD = re.compile(r"static int (\w+)\(const casadi_real\*\* arg, casadi_real\*\* res, [^\n]*\{")
VARIABLE = re.compile(r"\ba\d+\b")
ASSIGNED = re.compile(r"  (a\d+)=([^=].*);$")
RESULT = re.compile(r"  if \(res\[\d+\]!=0\) res\[\d+\]\[\d+\]=[^;]*;$")

_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_OPERAND = rf"(a\d+|{_NUMBER})"
_ON_VECTORS = re.compile(
    rf"\({_OPERAND}[-+*/]{_OPERAND}\)|shared_quotient\({_OPERAND},{_OPERAND}\)"
    rf"|fn?m[as]\({_OPERAND},{_OPERAND},{_OPERAND}\)|\(-a\d+\)"
)
_CONSTANT = re.compile(rf"(?<![\w.]){_NUMBER}(?![\w.])")
_PRODUCT = re.compile(rf"\({_OPERAND}\*{_OPERAND}\)|casadi_sq\((a\d+)\)")
_QUOTIENT = re.compile(rf"\({_OPERAND}/(a\d+)\)")
_SUM = re.compile(rf"\({_OPERAND}([+-]){_OPERAND}\)")


@dataclass(frozen=True)
class Straight:
    """A function that is assignments one after the other, each variable assigned once.

    Attributes:
        head: its first line.
        targets: for each statement the variable that it assigns, or None for a result.
        texts: for each statement the expression, or the whole line of a result.
    """

    head: str
    targets: list[str | None]
    texts: list[str]

    def uses(self, k: int) -> list[str]:
        """Variables that a statement reads."""
        return VARIABLE.findall(self.texts[k])

    def line(self, k: int) -> str:
        """A statement as a line of C++, whose variables are vectors: structures would take compilers a third longer."""
        target, text = self.targets[k], self.texts[k]
        if target is None:
            return text
        if _ON_VECTORS.fullmatch(text):
            return f"  const vec {target}={_CONSTANT.sub(lambda number: f'splat({number[0]})', text)};"
        return f"  const vec {target}=lane({VARIABLE.sub(lambda name: f'lane({name[0]})', text)}).v;"


def straight(function: str) -> Straight | None:
    """The function's statements, or None if it is more than assignments one after the other."""
    head, *body = function.split("\n")
    if HEAD.fullmatch(head) is None or body[-2:] != ["  return 0;", "}"]:
        return None
    targets, texts, now = list[str | None](), list[str](), dict[str, str]()
    for line in body[:-2]:
        if line.startswith("  casadi_real "):
            continue
        given = ASSIGNED.fullmatch(line)
        if given is None and RESULT.fullmatch(line) is None:
            return None
        text = VARIABLE.sub(lambda name: now[name[0]], given[2] if given else line)
        if given:
            now[given[1]] = f"a{len(texts)}"
        targets.append(f"a{len(texts)}" if given else None)
        texts.append(text)
    return Straight(head, targets, texts)


def fused(function: Straight) -> Straight:
    """The same with `fma` for every product that only sums and differences use, and for its sum; one in each sum."""
    products = _products(function)
    summed = dict.fromkeys(products, True)
    for k in range(len(function.texts)):
        if _SUM.fullmatch(function.texts[k]) is None:
            for name in function.uses(k):
                summed[name] = False
    texts = list(function.texts)
    for k, text in enumerate(function.texts):
        match = _SUM.fullmatch(text)
        if match is None:
            continue
        left, sign, right = match.groups()
        # Of two products the first is multiplied on its own, being ready sooner.
        if summed.get(right, False) and right in products and right != left:
            x, y = products[right]
            texts[k] = f"fma({x},{y},{left})" if sign == "+" else f"fnma({x},{y},{left})"
        elif summed.get(left, False) and left in products and right != left:
            x, y = products[left]
            texts[k] = f"fma({x},{y},{right})" if sign == "+" else f"fms({x},{y},{right})"
    return _without_dead(Straight(function.head, function.targets, _shared(texts)))


def _shared(texts: Sequence[str]) -> list[str]:
    """Divisions by what others divide by, too, as such: a division takes a processor several products' time."""
    divisors = Counter(match[2] for match in map(_QUOTIENT.fullmatch, set(texts)) if match)
    return [
        f"shared_quotient({match[1]},{match[2]})" if match and divisors[match[2]] > 1 else text
        for text, match in zip(texts, map(_QUOTIENT.fullmatch, texts), strict=True)
    ]


def _products(function: Straight) -> dict[str, tuple[str, str]]:
    """Variables that are a product, and of what."""
    found: dict[str, tuple[str, str]] = {}
    for target, text in zip(function.targets, function.texts, strict=True):
        match = _PRODUCT.fullmatch(text)
        if target and match:
            found[target] = (match[3], match[3]) if match[3] else (match[1], match[2])
    return found


def _without_dead(function: Straight) -> Straight:
    """Without the statements that nothing uses."""
    wanted, kept = set[str](), list[int]()
    for k in reversed(range(len(function.texts))):
        target = function.targets[k]
        if target is None or target in wanted:
            kept.append(k)
            wanted.update(function.uses(k))
    order: Sequence[int] = kept[::-1]
    return Straight(function.head, [function.targets[k] for k in order], [function.texts[k] for k in order])
