"""Straight-line functions of generated code cut into pieces.

In: a function's statements. Out: its text; of a long one as a series of calls, so that compilation takes a time linear
in length, or with what depends on one input alone apart, which is then computed once for many points. What one piece
computes and a later one needs travels through an array.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

from flexopt.compiled.fused import HEAD, Straight

# Compilers take a time that grows with the square of a function's length, from here on minutes.
LONG = 12_000
# Of shorter pieces more values travel through memory; longer ones compile no faster and run no faster.
PIECE = 1500

_INPUT = re.compile(r"\barg\[(\d+)\]\[")


def in_pieces(function: Straight, *, long: int = LONG, piece: int = PIECE) -> str:
    """The function's text, in pieces if it has more than `long` statements."""
    count = len(function.texts)
    if count <= long:
        return "\n".join([function.head, *map(function.line, range(count)), "  return 0;", "}"])
    edges = [*range(0, count, piece), count]
    needed = _needed(function, edges)
    match = HEAD.fullmatch(function.head)
    assert match is not None
    name, texts, place, free, size = match[1], list[str](), dict[str, int](), list[int](), 0
    for k, (start, end) in enumerate(pairwise(edges)):
        own = [target for target in function.targets[start:end] if target]
        carried = sorted(needed[k].intersection(*[{v for i in range(start, end) for v in function.uses(i)}]))
        read = [f"  const vec {v}=s[{place[v]}].v;" for v in carried]
        # A place whose value nobody needs any more is free again: pieces read before they write.
        for value in needed[k] - needed[k + 1]:
            free.append(place.pop(value))
        kept = list[str]()
        for value in sorted(needed[k + 1].intersection(own)):
            place[value] = free.pop() if free else size
            size = max(size, place[value] + 1)
            kept.append(f"  s[{place[value]}]={value};")
        opening = (
            f"static __attribute__((noinline)) void {name}_{k}(const casadi_real** arg, casadi_real** res, "
            "casadi_real* s) {"
        )
        texts += [opening, *read, *(function.line(i) for i in range(start, end)), *kept, "}"]
    calls = [f"  {name}_{k}(arg, res, s);" for k in range(len(edges) - 1)]
    return "\n".join([*texts, function.head, f"  casadi_real s[{size} + 1];", *calls, "  return 0;", "}"])


def beforehand(function: Straight, given: int) -> tuple[str, str, int]:
    """What depends on input `given` alone, as a function NAME_before(arg, w); the rest; how many values w has."""
    moving, computed = set[str](), set[str]()
    early, late, read = list[int](), list[int](), set[str]()
    for k, (target, text) in enumerate(zip(function.targets, function.texts, strict=True)):
        used = function.uses(k)
        if target is None or not moving.isdisjoint(used) or any(int(i) != given for i in _INPUT.findall(text)):
            late.append(k)
            moving.update([target] if target else [])
            read.update(used)
        else:
            early.append(k)
            computed.update([target] if used else [])
    kept = [v for k in early if (v := function.targets[k]) in read and v in computed]
    match = HEAD.fullmatch(function.head)
    assert match is not None
    # What is merely read, numbers and inputs, is read again.
    again = [k for k in early if function.targets[k] in read and function.targets[k] not in computed]
    before = [f"static void {match[1]}_before(const casadi_real** arg, casadi_real* w) {{", *map(function.line, early)]
    before += [*(f"  w[{place}]={value};" for place, value in enumerate(kept)), "}"]
    rest = [function.head, *(f"  const vec {value}=w[{place}].v;" for place, value in enumerate(kept))]
    rest += [*map(function.line, sorted([*again, *late])), "  return 0;", "}"]
    return "\n".join(before), "\n".join(rest), len(kept)


def _needed(function: Straight, edges: Sequence[int]) -> list[set[str]]:
    """Variables that hold a value which is still to be used, at each edge between pieces."""
    live, result = set[str](), [set[str]()]
    for start, end in reversed(list(pairwise(edges))):
        for at in range(end - 1, start - 1, -1):
            live.discard(function.targets[at] or "")
            live.update(function.uses(at))
        result.append(set(live))
    return result[::-1]
