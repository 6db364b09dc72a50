"""What the object files and the sources show: no allocation, no static state, no recursion, bounded loops, no double.

In: a `Bench` and a compiler. Out: one check for each target.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from flexopt.export.kernels import MATH
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Check, Finding, Table, Target, attempt
from flexopt.export.verify.tools import need, run

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
        done: set[str] = set()
        path: list[str] = []

        def visit(name: str) -> list[str]:
            if name in path:
                return path[path.index(name) :]
            if name in done:
                return []
            path.append(name)
            for callee in sorted(self.calls.get(name, ())):
                found = visit(callee)
                if found:
                    return found
            path.pop()
            done.add(name)
            return []

        for name in sorted(self.calls):
            found = visit(name)
            if found:
                return found
        return []

    def stack_from(self, name: str) -> int:
        """Bytes of the deepest chain of calls from a function; functions of other libraries count nothing."""
        return self.stack.get(name, 0) + max((self.stack_from(c) for c in self.calls.get(name, ())), default=0)


def check_objects(bench: Bench, target: Target, compiler: str, flags: Sequence[str]) -> Check:
    """The objects that `compiler` makes of the library."""
    return attempt("object files and sources", target, lambda: _examined(bench, target, compiler, flags))


def accounted(bench: Bench, target: Target, compiler: str, flags: Sequence[str]) -> dict[str, Path]:
    """Objects beside which the compiler wrote its account of calls and frames."""
    return bench.objects(f"objects-{target}", compiler, [*flags, "-fcallgraph-info=su"])


def _examined(bench: Bench, target: Target, compiler: str, flags: Sequence[str]) -> Finding:
    tools = "arm-none-eabi-" if compiler.startswith("arm") else ""
    nm, objdump = f"{tools}nm", f"{tools}objdump"
    need(compiler, nm, objdump)
    built = accounted(bench, target, compiler, flags)
    own = {f"{bench.library.prefix}_{name}" for name in ("status_text", "build_info", "default_parameters")}
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
        count, found = unbounded_loops(source.read_text(encoding="utf-8"))
        loops += count
        faults += [f"{source.name}: {line}" for line in found]
    rows = tuple((name, graph.stack[name], graph.stack_from(name)) for name in sorted(own & set(graph.stack)))
    table = Table("Stack by the compiler's account, bytes", ("function", "its own frame", "with what it calls"), rows)
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
                name = title.rpartition(":")[2]
                graph.stack[name] = max(graph.stack.get(name, 0), int(frame[1]))
                if frame[2] != "static":
                    graph.dynamic.add(name)
        for caller, callee in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            graph.calls.setdefault(caller.rpartition(":")[2], set()).add(callee.rpartition(":")[2])
    return graph


_FOR = re.compile(r"\bfor \(([^;]*);\s*(\w+)\s*(?:<|!=)\s*([^;]+);\s*(?:\+\+\s*(\w+)|(\w+)\s*\+=\s*\d+)\)\s*(.*)")


def unbounded_loops(text: str) -> tuple[int, list[str]]:
    """How many loops a source has, and those not counted by one variable up to a bound that stays.

    A loop is `for (…; k < bound; ++k)` with a k that its body does not change, and a bound of constants and of
    parameters that are never assigned.
    """
    code = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)
    faults = [
        f"a loop of another kind: {line.strip()}"
        for line in code.splitlines()
        if re.search(r"\b(while|do|goto)\b", line)
    ]
    lines = code.splitlines()
    count = 0
    for number, line in enumerate(lines):
        for start in re.finditer(r"\bfor \(", line):
            count += 1
            match = _FOR.match(line, start.start())
            if match is None or match[2] != (match[4] or match[5]):
                faults.append(f"not a counted loop: {line.strip()}")
                continue
            body = _body(lines, number, match[6])
            changed = rf"(\+\+|--)\s*{match[2]}\b|\b{match[2]}\s*(\+\+|--|[-+*/]?=(?!=))"
            bounds = [w for w in re.findall(r"[A-Za-z_]\w*", match[3]) if w.islower()]
            assigned = any(re.search(rf"\b{w}\s*[-+*/]?=(?!=)|(\+\+|--)\s*{w}\b|\b{w}(\+\+|--)", body) for w in bounds)
            if re.search(changed, body) or assigned:
                faults.append(f"a loop that changes its own counter or bound: {line.strip()}")
    return count, faults


def _body(lines: list[str], number: int, rest: str) -> str:
    """Text of a loop's body: the statement that follows, or the block."""
    if "{" not in rest:
        return rest
    depth, body = rest.count("{") - rest.count("}"), [rest]
    while depth > 0 and number + 1 < len(lines):
        number += 1
        body.append(lines[number])
        depth += lines[number].count("{") - lines[number].count("}")
    return "\n".join(body)
