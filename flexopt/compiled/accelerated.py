"""The compiled twin of a Function.

In: any Function that CasADi can write as C. Out: the same Function, names and derivatives included, from a shared
library; or the Function itself where that cannot be.
"""

from __future__ import annotations

import re

import casadi as ca

from flexopt.compiled.libraries import opened

_PREFIX = "flexopt_"
_EXPORT = """#if defined(_WIN32)
#define CASADI_SYMBOL_EXPORT __declspec(dllexport)
#else
#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))
#endif
"""
# Up to so many lines of generated code each level stays within about 10 s.
_LEVELS = ((30_000, ("-O2",)), (60_000, ("-O1",)))


def accelerate(function: ca.Function, *, order: int = 2) -> ca.Function:
    """`function`, compiled: same names, shapes and defaults of inputs and outputs, called `flexopt_` + its name.

    Its derivatives up to `order` (0, 1 or 2) are compiled with it: forward and reverse products, and the forward
    product of the reverse one. Of these CasADi composes Jacobians, gradients and Hessians; higher ones do not exist.

    Returns `function` itself when there is no compiler (told once for each process), when its code does not compile,
    and when it calls what is not part of it: a Callback, another library.
    """
    if function.is_a("External"):
        return function
    name = _PREFIX + function.name()
    twin = opened(
        [function], f"accelerate {order}", lambda: _source(function, order), level_for, "c",
        lambda path: ca.external(name, str(path)),
    )  # fmt: skip
    return function if twin is None else twin


def level_for(source: str, levels: tuple[tuple[int, tuple[str, ...]], ...] = _LEVELS) -> tuple[str, ...] | None:
    """How hard to optimise, so that compilation takes seconds; None where it would take too long."""
    lines = source.count("\n")
    return next((level for most, level in levels if lines <= most), None)


def _source(function: ca.Function, order: int) -> str:
    """C code of the Function and its derivatives, every exported name with our prefix.

    Without it a Function called `step` would meet the function of that name in the C library.
    """
    functions = [function]
    if order >= 1:
        functions += [function.forward(1), function.reverse(1)]
    if order >= 2:
        functions.append(function.reverse(1).forward(1))
    generator = ca.CodeGenerator("flexopt_generated")
    for each in functions:
        generator.add(each)
    name = re.compile(rf"\b((?:(?:jac|fwd1|adj1)_)*)({re.escape(function.name())})(?=\(|_[a-z])")
    text = generator.dump()
    if re.search(r"^int \w+\(const casadi_real\*\* arg.*;$", text, re.MULTILINE):
        raise RuntimeError(f"{function.name()} calls a function of another library")
    exported = re.compile("^CASADI_SYMBOL_EXPORT.*$", re.MULTILINE)
    return _EXPORT + exported.sub(lambda line: name.sub(rf"\1{_PREFIX}\2", line[0]), text)
