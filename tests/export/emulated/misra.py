"""MISRA C:2012 by cppcheck's addon: every rule that is not kept must have a reason in the bundle.

In: a `Bench`. Out: a finding. The addon covers a part of the rules; a bundle that passes is no certificate. cppcheck's
time grows with the square of a function's length, so it sees the long straight kernels in pieces.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable
from flexopt.export.verify.tools import run

DEVIATIONS = "misra_deviations.json"
PIECE = 200  # statements
SECONDS = 7200.0  # a machine in space takes the addon minutes, more beside other work


def examined(bench: Bench) -> Finding:
    """Examine the library's sources."""
    copies: list[Path] = []
    for source in bench.sources:
        copies.append(bench.scratch / f"misra-{source.name}")
        copies[-1].write_text(in_pieces(source.read_text(encoding="utf-8")), encoding="utf-8")
    said = run(
        ["cppcheck", "--addon=misra", "--std=c99", "--enable=warning,performance,portability", "--quiet",
         "--suppress=missingIncludeSystem", "--suppress=uninitvar", "--suppress=legacyUninitvar",
         "--template={file}:{line}: {id}: {message}", *bench.includes()[:2],
         *copies],
        folder=bench.scratch,
        seconds=SECONDS,
    ).err  # fmt: skip
    deviations = json.loads((bench.folder / DEVIATIONS).read_text(encoding="utf-8"))
    found = Counter(re.findall(r": misra-c2012-([\d.]+):", said))
    # A piece need not use every parameter of its kernel; the compilers warn where a whole kernel does not.
    found.pop("2.7", None)
    others = [line for line in said.splitlines() if "misra-c2012" not in line and re.search(r":\d+: ", line)]
    faults = [f"rule {rule}: {count} times, without a reason in {DEVIATIONS}" for rule, count in found.items()
              if rule not in deviations]  # fmt: skip
    faults += others
    rows = tuple(
        (rule, count, deviations.get(rule, {}).get("where", ""), deviations.get(rule, {}).get("reason", "none"))
        for rule, count in sorted(found.items(), key=lambda item: [int(part) for part in item[0].split(".")])
    )
    table = FindingTable("Rules not kept", ("rule", "times", "where", "reason"), rows)
    return Finding(f"{len(found)} rules are not kept, each with a reason; cppcheck finds nothing else", faults, [table])


def in_pieces(text: str) -> str:
    """The source with every straight kernel of more than `PIECE` statements cut into several functions.

    The pieces declare those of the kernel's variables again that they use. What runs through a whole kernel, such as
    variables that are read before they are set, is left to the compilers' warnings.
    """

    def cut(match: re.Match[str]) -> str:
        head, name, rest, body = match.groups()
        lines = body.splitlines()
        declarations = [line for line in lines if re.match(r"  \w+_real a\d", line)]
        statements = [line for line in lines if line not in declarations and line != "  return 0;"]
        if len(statements) <= PIECE or any(re.search(r"\b(for|return)\b", line) for line in statements):
            return match[0]
        parts: list[str] = []
        for start in range(0, len(statements), PIECE):
            piece = statements[start : start + PIECE]
            inside = [*_needed(declarations, piece), *piece, "  return 0;"]
            # The last piece has the kernel's own name.
            label = name if start + PIECE >= len(statements) else f"{name}_{start}"
            parts.append("\n".join([f"{head}{label}{rest}", *inside, "}"]))
        return "\n\n".join(parts) + "\n"

    return re.sub(r"(?ms)^(static int )(kernel_\w+)(\([^)]*\) \{)\n(.*?)^\}\n", cut, text)


def _needed(declarations: list[str], piece: list[str]) -> list[str]:
    """Declarations of the variables that a piece uses."""
    used = set(re.findall(r"\b[a-z]\w*", "\n".join(piece)))
    lines: list[str] = []
    for line in declarations:
        kind, _, names = line.strip().removesuffix(";").partition(" ")
        kept = [name for name in names.split(", ") if name.partition("=")[0].strip() in used]
        lines += [f"  {kind} {', '.join(kept)};"] if kept else []
    return lines
