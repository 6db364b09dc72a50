"""What the object files and the sources show: no allocation, no static state, no recursion, bounded loops, no double.

In: a `Bench` and a compiler. Out: findings.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path

from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable
from flexopt.export.verify.tools import run

# Of the mathematical library.
MATH = (
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "sqrt", "exp", "log", "log10", "pow",
    "fabs", "fmin", "fmax", "floor", "ceil", "fmod", "copysign", "hypot", "expm1", "log1p", "erf",
)  # fmt: skip
# What compilers call by themselves: copying, and arithmetic that the processor has not.
_COMPILER_OWN = re.compile(r"memcpy|memset|memmove|sincosf?|__aeabi_\w+|__errno|_GLOBAL_OFFSET_TABLE_|__stack_chk_fail")
_SOFT_DOUBLE = re.compile(r"__aeabi_(c?d\w+|[a-z]+2d)|__\w+df\w*|sincos")
_ARM_DOUBLE = re.compile(r"\.f64")
_X86_DOUBLE = re.compile(
    r"\b(v?(add|sub|mul|div|sqrt|min|max|ucomi|comi|f[n]?m(add|sub)\d*)(sd|pd)|v?cvt\w*(sd|pd)\w*)\b"
)


@dataclass(frozen=True)
class CallGraph:
    """Who calls whom, and the stack each function takes.

    Attributes:
        calls: caller -> callees.
        stack: function -> bytes of its own frame.
        dynamic: functions whose frame has no fixed size.
    """

    calls: dict[str, set[str]] = field(default_factory=dict[str, set[str]])
    stack: dict[str, int] = field(default_factory=dict[str, int])
    dynamic: set[str] = field(default_factory=set[str])

    def cycle(self) -> list[str]:
        """Functions that call themselves, directly or not; empty where there is no recursion."""
        try:
            TopologicalSorter({name: sorted(self.calls[name]) for name in sorted(self.calls)}).prepare()
        except CycleError as error:
            # From callee to caller, the first one again in the end.
            return error.args[1][:0:-1]
        return []

    def stack_from(self, name: str) -> int:
        """Bytes of the deepest chain of calls from a function; functions of other libraries count nothing."""
        return self.stack.get(name, 0) + max((self.stack_from(c) for c in self.calls.get(name, ())), default=0)


def accounted(bench: Bench, label: str, compiler: str, flags: Sequence[str]) -> dict[str, Path]:
    """Objects beside which the compiler wrote its account of calls and frames."""
    return bench.objects(f"objects-{label}", compiler, [*flags, "-fcallgraph-info=su"])


def examined(bench: Bench, label: str, compiler: str, flags: Sequence[str]) -> Finding:
    """Examine the objects that `compiler` makes of the library."""
    tools = "arm-none-eabi-" if compiler.startswith("arm") else ""
    nm, objdump = f"{tools}nm", f"{tools}objdump"
    built = accounted(bench, label, compiler, flags)
    own = {
        f"{bench.library.prefix}_{name}" for name in ("status_text", "has_output", "build_info", "default_parameters")
    }
    own |= {f"{bench.library.prefix}_{o.name}" for o in bench.library.all_operations}
    faults: list[str] = []
    exported: set[str] = set()
    for part, path in built.items():
        faults += [f"{part}: {fault}" for fault in _symbols(bench, nm, path, own, exported)]
        sizes = section_sizes(objdump, path)
        if sizes["ram"]:
            faults.append(f"{part}: {sizes['ram']} bytes of static mutable state")
        if bench.single:
            double = _X86_DOUBLE if not tools else _ARM_DOUBLE
            code = run([objdump, "-d", "--no-show-raw-insn", path], folder=bench.scratch).out
            lines = [line.strip() for line in code.splitlines() if double.search(line)]
            faults += [f"{part}: an instruction on doubles: {lines[0]}"] if lines else []
    faults += [f"exports {name}" for name in sorted(exported - own)]
    graph = call_graph(built)
    if not own <= exported | {f"{bench.library.prefix}_default_parameters"} or not own & set(graph.stack):
        faults.append("functions of the header are missing from the objects or from the call graph")
    cycle = graph.cycle()
    faults += [f"recursion: {' -> '.join(cycle)}"] if cycle else []
    faults += [f"{name}: a stack frame without fixed size" for name in sorted(graph.dynamic)]
    loops = 0
    for source in [*bench.sources, *(bench.folder / "src").glob("*_internal.h")]:
        text = source.read_text(encoding="utf-8")
        count, found = unbounded_loops(text)
        loops += count
        faults += [f"{source.name}: {line}" for line in found]
    rows = tuple((name, graph.stack[name], graph.stack_from(name)) for name in sorted(own & set(graph.stack)))
    table = FindingTable(
        "Stack by the compiler's account, bytes", ("function", "its own frame", "with what it calls"), rows
    )
    sentence = f"no allocation, no static mutable state, no recursion, {loops} loops all counted and bounded"
    sentence += ", no double" if bench.single else ""
    return Finding(sentence, faults, [table])


def _symbols(bench: Bench, nm: str, path: Path, own: set[str], exported: set[str]) -> list[str]:
    """Undefined symbols that may not be, and data that can change."""
    math = {f"{name}f" for name in MATH} if bench.single else set(MATH)
    faults: list[str] = []
    for line in run([nm, path], folder=bench.scratch).out.splitlines():
        kind, name = line.split()[-2:]
        if kind in "Uw":
            if name not in own | math and not _COMPILER_OWN.fullmatch(name):
                faults.append(f"needs {name}")
            elif bench.single and _SOFT_DOUBLE.fullmatch(name):
                faults.append(f"computes with doubles: {name}")
        elif kind in "DdBbCGgSs":
            faults.append(f"keeps state in {name}")
        elif kind == "T":
            exported.add(name)
    return faults


def section_sizes(objdump: str, path: Path) -> dict[str, int]:
    """Bytes that an object takes in flash (code and constants) and in static RAM."""
    flash = ram = 0
    lines = run([objdump, "-h", path], folder=path.parent).out.splitlines()
    for header, flags in pairwise(lines):
        match = re.match(r"\s*\d+ (\S+)\s+([0-9a-f]+) ", header)
        if match is None or "ALLOC" not in flags or "note" in match[1] or "eh_frame" in match[1]:
            continue
        size = int(match[2], 16)
        flash, ram = (flash + size, ram) if "READONLY" in flags else (flash, ram + size)
    return {"flash": flash, "ram": ram}


def call_graph(built: dict[str, Path]) -> CallGraph:
    """The compiler's own account of calls and frames beside `accounted` objects (gcc's -fcallgraph-info)."""
    graph = CallGraph()
    for path in built.values():
        text = path.with_suffix(".ci").read_text(encoding="utf-8")
        for title, text_label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', text):
            frame = re.search(r"(\d+) bytes \(([^)]*)\)", text_label)
            if frame:
                # A static function's title begins with its file: each has functions of the same names.
                graph.stack[title] = int(frame[1])
                if frame[2] != "static":
                    graph.dynamic.add(title)
        for caller, callee in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            graph.calls.setdefault(caller, set()).add(callee)
    return graph


_BOUND = re.compile(r"(\w+)\s*(<=|<|>=|>|!=)\s*(.+)", flags=re.DOTALL)
_STEP = re.compile(r"(?:(\+\+|--)\s*(\w+)|(\w+)\s*(?:(\+\+|--)|([-+])=\s*\d+))")


def unbounded_loops(text: str) -> tuple[int, list[str]]:
    """How many loops a source has, and those not counted by one variable up to a bound that stays.

    A loop is `for (…; k < bound && …; ++k)`, or the same downwards, with a k that its body does not change, and a bound
    of constants, of parameters and of members that the body does not assign. What a called function does to a member is
    not seen.
    """
    code = _without_comments(text)
    faults = [
        f"a loop of another kind: {line.strip()}"
        for line in code.splitlines()
        if re.search(r"\b(while|do|goto)\b", line)
    ]
    count = 0
    for _, head, body in _loops(code):
        count += 1
        shown = f"for ({' '.join(head.split())})"
        bound = _bound(head)
        if bound is None:
            faults.append(f"not a counted loop: {shown}")
            continue
        counter, limit = bound
        changed = rf"(\+\+|--)\s*{counter}\b|\b{counter}\s*(\+\+|--|[-+*/]?=(?!=))"
        words = [w for w in re.findall(r"[A-Za-z_]\w*", limit) if w.islower()]
        assigned = any(re.search(rf"\b{w}\s*[-+*/]?=(?!=)|(\+\+|--)\s*{w}\b|\b{w}(\+\+|--)", body) for w in words)
        if re.search(changed, body) or assigned:
            faults.append(f"a loop that changes its own counter or bound: {shown}")
    return count, faults


def _without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)


def _loops(code: str) -> Iterator[tuple[int, str, str]]:
    """Where each loop stands, what is between its parentheses, and its body."""
    for start in re.finditer(r"\bfor \(", code):
        end = _closing(code, start.end() - 1, "()")
        rest = code[end + 1 :]
        opened = re.match(r"\s*\{", rest)
        body = rest[: _closing(rest, opened.end() - 1, "{}") + 1] if opened else rest.split(";", 1)[0]
        yield start.start(), code[start.end() : end], body


def _closing(code: str, start: int, pair: str) -> int:
    """Index of what closes the parenthesis or brace at `start`."""
    depth = 0
    for index in range(start, len(code)):
        depth += (code[index] == pair[0]) - (code[index] == pair[1])
        if depth == 0:
            return index
    return len(code)


def _bound(head: str) -> tuple[str, str] | None:
    """Counter and bound of a loop's head; None where it is not counted."""
    parts = [part.strip() for part in head.split(";")]
    if len(parts) != 3 or "||" in parts[1]:
        return None
    step = _STEP.fullmatch(parts[2])
    if step is None:
        return None
    counter = step[2] or step[3]
    sign = (step[1] or step[4] or step[5])[0]
    for condition in parts[1].split("&&"):
        plain = condition.strip()
        plain = plain[1:-1] if plain.startswith("(") and _closing(plain, 0, "()") == len(plain) - 1 else plain
        match = _BOUND.fullmatch(plain)
        if match and match[1] == counter and (match[2] == "!=" or (match[2][0] == "<") == (sign == "+")):
            return counter, match[3]
    return None
