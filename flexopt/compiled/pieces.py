"""Long straight-line functions of generated code cut into pieces, so that compilation takes a time linear in length.

In: the text of one function as CasADi writes it for an SX graph, a statement a line. Out: the same function as a series
of calls; what one piece computes and a later one needs travels through an array on the stack.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

# Compilers take a time that grows with the square of a function's length, from here on minutes.
LONG = 12_000
# Of shorter pieces more values travel through memory; longer ones compile no faster and run no faster.
PIECE = 1500

_HEAD = re.compile(r"static int (\w+)\(const casadi_real\*\* arg, casadi_real\*\* res, [^\n]*\{")
_VARIABLE = re.compile(r"\ba\d+\b")
_ASSIGNED = re.compile(r"  (a\d+)=([^=].*);$")
_RESULT = re.compile(r"  if \(res\[\d+\]!=0\) res\[\d+\]\[\d+\]=[^;]*;$")


def in_pieces(function: str, *, long: int = LONG, piece: int = PIECE) -> str:
    """The function in pieces, or as it is if it is not long, or is more than assignments one after the other."""
    head, *body = function.split("\n")
    match = _HEAD.fullmatch(head)
    if len(body) <= long or match is None or body[-2:] != ["  return 0;", "}"]:
        return function
    statements = [line for line in body[:-2] if not line.startswith("  casadi_real ")]
    given = [_ASSIGNED.fullmatch(line) for line in statements]
    if not all(at or _RESULT.fullmatch(line) for at, line in zip(given, statements, strict=True)):
        return function
    sets = [at[1] if at else None for at in given]
    uses = [
        {found[0] for found in _VARIABLE.finditer(at[2] if at else line)}
        for at, line in zip(given, statements, strict=True)
    ]
    edges = [*range(0, len(statements), piece), len(statements)]
    needed = _needed(sets, uses, edges)
    place = {name: k for k, name in enumerate(sorted({v for v in sets if v}.union(*uses)))}
    name, texts = match[1], list[str]()
    for k, (start, end) in enumerate(pairwise(edges)):
        used, written = set[str]().union(*uses[start:end]), {v for v in sets[start:end] if v}
        carried = needed[k] & used
        local = [f"{v}=s[{place[v]}]" if v in carried else v for v in sorted(used | written)]
        kept = [f"  s[{place[v]}]={v};" for v in sorted(written & needed[k + 1])]
        opening = (
            f"static __attribute__((noinline)) void {name}_{k}(const casadi_real** arg, casadi_real** res, "
            "casadi_real* s) {"
        )
        declared = [f"  casadi_real {', '.join(local)};"] if local else []
        texts += [opening, *declared, *statements[start:end], *kept, "}"]
    calls = [f"  {name}_{k}(arg, res, s);" for k in range(len(edges) - 1)]
    return "\n".join([*texts, head, f"  casadi_real s[{len(place)}];", *calls, "  return 0;", "}"])


def _needed(sets: Sequence[str | None], uses: Sequence[set[str]], edges: Sequence[int]) -> list[set[str]]:
    """Variables that hold a value which is still to be used, at each edge between pieces."""
    live, result = set[str](), [set[str]()]
    for start, end in reversed(list(pairwise(edges))):
        for at in range(end - 1, start - 1, -1):
            live.discard(sets[at] or "")
            live |= uses[at]
        result.append(set(live))
    return result[::-1]
