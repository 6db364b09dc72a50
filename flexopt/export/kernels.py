"""C text of the computations themselves, from CasADi Functions.

In: Functions with dense inputs and outputs. Out: static C functions that compile without a warning, in double or wholly
in single precision. CasADi's generator writes the evaluation; what is done here: definitions that are not reached go,
as do parameters and variables that are not used; constants become single-precision ones; names say which operation they
belong to.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from flexopt.compiled.lanes import definitions, reached_from

Real = Literal["double", "float"]

_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?![\w.])")
_SINGLE_MIN, _SINGLE_MAX = 1.17549435e-38, 3.40282347e38
# Helpers of the generator that test for old compilers, written for ours.
_OWN = {
    "casadi_fabs": "static casadi_real casadi_fabs(casadi_real x) { return fabs(x); }",
    "casadi_fmin": "static casadi_real casadi_fmin(casadi_real x, casadi_real y) { return (x < y) ? x : y; }",
    "casadi_fmax": "static casadi_real casadi_fmax(casadi_real x, casadi_real y) { return (x > y) ? x : y; }",
    "casadi_if_else": "static casadi_real casadi_if_else(casadi_real c, casadi_real x, casadi_real y) "
    "{ return (c != 0.) ? x : y; }",
}
_PARAMETERS = {
    "arg": "const casadi_real **arg",
    "res": "casadi_real **res",
    "iw": "casadi_int *iw",
    "w": "casadi_real *w",
}
_CALL = re.compile(r"\b(casadi_f\d+)\(([^,()]+), ([^,()]+), ([^,()]+), ([^,()]+), 0\)")


# Where the first word stands in a line, the pattern is replaced: tests spelled out.
_TIDIED = tuple(
    (mark, re.compile(pattern), replacement)
    for mark, pattern, replacement in (
        ("?", r"\((\w+)\?(\w+):0\)", r"((\1 != 0.) ? \2 : 0.)"),
        ("=(!", r"=\(!(\w+)\);", r"=((\1 == 0.) ? 1. : 0.);"),
        ("=(", r"=\((\w+)(&&|\|\|)(\w+)\);", r"=(((\1 != 0.) \2 (\3 != 0.)) ? 1. : 0.);"),
        ("=(", r"=(\(\w+(?:<|<=|==|!=)\w+\));", r"=(\1 ? 1. : 0.);"),
        ("?", r"\b(arg\[\d+\]) ?\? ?", r"(\1 != NULL) ? "),
        ("to_int", r"\(arg\[0\] != NULL\) \? casadi_to_int\(\*arg\[0\]\) : 0", "arg[0][0] != 0."),
        ("if (", r"if \((res\[\d+\])(?:!=0)?\) (.*)$", r"if (\1 != NULL) { \2 }"),
        ("if (", r"if \((casadi_\w+\(.*\))\) return 1;", r"if (\1 != 0) { return 1; }"),
        ("1[", r"\b(arg1|res1)\[(\d+)\]=0;", r"\1[\2]=NULL;"),
    )
)


class Unsupported(ValueError):
    """The generator has no C for a Function."""


@dataclass(frozen=True)
class Kernel:
    """A generated function and what it needs.

    Attributes:
        name: of the static C function.
        parameters: which of arg, res, iw, w it takes, in this order; it returns 0 on success.
        sz_arg, sz_res, sz_iw, sz_w: lengths of the arrays behind the parameters.
    """

    name: str
    parameters: tuple[str, ...]
    sz_arg: int
    sz_res: int
    sz_iw: int
    sz_w: int


@dataclass(frozen=True)
class KernelText:
    """The C text of one part.

    Attributes:
        text: definitions in the order C needs.
        kernels: the Functions' own, by their names.
    """

    text: str
    kernels: dict[str, Kernel]


def kernel_text(functions: Sequence[ca.Function], real: Real, real_type: str) -> KernelText:
    """Static C functions for `functions`, which share what they have in common.

    Args:
        functions: with dense inputs and outputs, and different names.
        real: precision of every computation and constant.
        real_type: name of the C type.

    Raises:
        Unsupported: a Function contains what cannot be generated.
    """
    generator = ca.CodeGenerator("kernels", {"with_export": False, "include_math": False, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    pieces = definitions(generator.dump())
    roots: dict[str, str] = {}
    for function in functions:
        match = re.search(r"return (casadi_\w+)\(", pieces[function.name()])
        if match is None:
            raise Unsupported(f"{function.name()}: the generator wrote no evaluation")
        roots[function.name()] = match[1]
    pieces |= {name: text for name, text in _OWN.items() if name in pieces}
    wanted = set[str]().union(*(reached_from(pieces, root) for root in roots.values()))
    # The wrappers pass every argument; where no call inside leaves one out, nothing needs to ask for it.
    nothing_missing = not any(re.search(r"arg1\[\d+\]=0;", pieces[name]) for name in wanted)
    taken: dict[str, tuple[str, ...]] = {}
    texts: list[str] = []
    for name, piece in pieces.items():
        if name not in wanted:
            continue
        text = _without_comments(piece)
        if re.match(r"casadi_f\d+$", name):
            is_root = name in roots.values()
            text, taken[name] = _tidied(text, name, taken, is_root=is_root, all_given=is_root or nothing_missing)
        elif not text.startswith("static"):
            text = f"static {text}"
        texts.append(_tables(text))
    # What was asked for by tests alone that are gone.
    joined = "\n\n".join(texts)
    for name in ("casadi_zeros", "casadi_to_int"):
        if len(re.findall(rf"\b{name}\b", joined)) == 1:
            texts = [text for text in texts if name not in text]
            joined = "\n\n".join(texts)
    if "casadi_error" in joined or "NOT IMPLEMENTED" in joined:
        raise Unsupported(f"{', '.join(roots)}: the generator has no C for a part of it")
    names = {root: f"kernel_{name}" for name, root in roots.items()}
    joined = _renamed(joined, names, real_type)
    joined = single_precision(joined) if real == "float" else joined
    kernels = {
        f.name(): Kernel(names[roots[f.name()]], taken[roots[f.name()]], f.sz_arg(), f.sz_res(), f.sz_iw(), f.sz_w())
        for f in functions
    }
    return KernelText(joined + "\n", kernels)


def single_precision(text: str) -> str:
    """Constants with the suffix f. Calls of the mathematical library are macros of the bundle's own header.

    Without the suffix no double is computed with either, as each constant is converted when it is compiled; but MSVC
    (C4305), -Wconversion and -Wunsuffixed-float-constants complain of every one, and only GCC has an option that makes
    them single (-fsingle-precision-constant). A bundle is compiled with its user's own compiler and options.
    """
    return _NUMBER.sub(lambda match: single_constant(match[1]), text)


def single_constant(digits: str) -> str:
    """A constant in single precision; what is smaller than any normal number becomes the smallest of them."""
    value = float(digits)
    if 0 < value < _SINGLE_MIN:
        return f"{_SINGLE_MIN:.9g}f"
    if value > _SINGLE_MAX:
        raise Unsupported(f"the constant {digits} is beyond single precision")
    return digits + "f"


def _without_comments(text: str) -> str:
    return re.sub(r"\n[ \t]*(?=\n)", "", re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL))


def _tidied(
    text: str, name: str, taken: dict[str, tuple[str, ...]], *, is_root: bool, all_given: bool
) -> tuple[str, tuple[str, ...]]:
    """A generated evaluation without what it does not use, and the parameters that are left."""
    if all_given:
        text = re.sub(r"arg\[(\d+)\] ?\? ?(arg\[\1\](?:\[\d+\])?) : (?:0|casadi_zeros)", r"\2", text)
    if is_root:
        # The wrappers take every result.
        text = re.sub(r"if \(res\[\d+\](?:!=0)?\) ", "", text)
    if taken:
        text = _CALL.sub(lambda call: _called(call, taken), text)
    head, _, body = text.partition("{\n")
    body = _declared(body)
    used = tuple(p for p in _PARAMETERS if re.search(rf"\b{p}\b", body))
    assert head.startswith("static int ")
    return f"static int {name}({', '.join(_PARAMETERS[p] for p in used) or 'void'}) {{\n{body}", used


def _called(call: re.Match[str], taken: Mapping[str, tuple[str, ...]]) -> str:
    """A call with the parameters that its callee has left."""
    callee, *passed = call.groups()
    if callee not in taken:
        return call[0]
    given = dict(zip(_PARAMETERS, passed, strict=True))
    return f"{callee}({', '.join(given[p] for p in taken[callee])})"


def _declared(body: str) -> str:
    """The body without declarations of what is not used."""
    lines = body.splitlines()
    declarations = {k: m for k, line in enumerate(lines) if (m := re.match(r"  ((?:const )?casadi_\w+ )(.*);$", line))}
    known = {k: match[2].split(", ") for k, match in declarations.items()}
    used = set(re.findall(r"\w+", "\n".join(line for k, line in enumerate(lines) if k not in declarations)))
    for k, match in declarations.items():
        kept = [d for d in known[k] if re.split(r"[=\[]", d.lstrip("*"))[0] in used]
        lines[k] = f"  {match[1]}{', '.join(kept)};" if kept else ""
    return "\n".join(_statement(line) for line in lines if line)


def _statement(line: str) -> str:
    """A line of the generator's with its tests spelled out: reals against 0, pointers against NULL."""
    for mark, pattern, replacement in _TIDIED:
        if mark in line:
            line = pattern.sub(replacement, line)
    return line


def _tables(text: str) -> str:
    """Tables without the generator's line ends behind the sign of equality."""
    return re.sub(r"= \n\s*", "= ", text)


def _renamed(text: str, names: dict[str, str], real_type: str) -> str:
    def renamed(match: re.Match[str]) -> str:
        word = match[0]
        if word in ("casadi_real", "casadi_int"):
            return real_type if word == "casadi_real" else "int"
        return names.get(word) or word.replace("casadi_", "kernel_")

    return re.sub(r"\bcasadi_\w+", renamed, text)
