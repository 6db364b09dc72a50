"""CasADi Functions as JavaScript: the same operations in the same order, on typed arrays.

In: an SX Function (one of calls is expanded). Out: the text of an object that knows its inputs and outputs and runs.
"""

from __future__ import annotations

import math
from collections import Counter

import casadi as ca

from flexopt.compiled.instructions import Instructions
from flexopt.errors import ExportError

# What a browser's compiler still takes as one piece; longer graphs are cut, and pass numbers on in an array.
PIECE = 1200
# Operations written into one expression, one inside the other.
DEPTH = 12

_FORMS = {
    ca.OP_ADD: "({0}+{1})",
    ca.OP_SUB: "({0}-{1})",
    ca.OP_MUL: "({0}*{1})",
    ca.OP_DIV: "({0}/{1})",
    ca.OP_NEG: "(-{0})",
    ca.OP_INV: "(1/{0})",
    ca.OP_TWICE: "(2*{0})",
    ca.OP_SQ: "({0}*{0})",
    ca.OP_ASSIGN: "{0}",
    ca.OP_LT: "(+({0}<{1}))",
    ca.OP_LE: "(+({0}<={1}))",
    ca.OP_EQ: "(+({0}==={1}))",
    ca.OP_NE: "(+({0}!=={1}))",
    ca.OP_NOT: "(+!{0})",
    ca.OP_AND: "(+!!({0}&&{1}))",
    ca.OP_OR: "(+!!({0}||{1}))",
    ca.OP_IF_ELSE_ZERO: "({0}?{1}:0)",
    ca.OP_POW: "Math.pow({0},{1})",
    ca.OP_CONSTPOW: "Math.pow({0},{1})",
    ca.OP_FMIN: "Math.min({0},{1})",
    ca.OP_FMAX: "Math.max({0},{1})",
    ca.OP_FMOD: "({0}%{1})",
    ca.OP_ATAN2: "Math.atan2({0},{1})",
    ca.OP_HYPOT: "Math.hypot({0},{1})",
    ca.OP_COPYSIGN: "copysign({0},{1})",
} | {
    getattr(ca, f"OP_{name.upper()}"): f"Math.{called}({{0}})"
    for name, called in {
        "sqrt": "sqrt", "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin", "acos": "acos", "atan": "atan",
        "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "exp": "exp", "log": "log", "log1p": "log1p",
        "expm1": "expm1", "floor": "floor", "ceil": "ceil", "fabs": "abs", "sign": "sign",
    }.items()
}  # fmt: skip
# Of these an operand stands in the form twice.
_TWICE = {ca.OP_SQ}


def script_of(function: ca.Function) -> str:
    """A Function as a JavaScript object `{inputs, outputs, run}`.

    `inputs` are [name, entries] in order, `outputs` [name, rows, columns]; `run(i, o)` takes arrays of `Float64Array`s
    and writes into those of `o`, entries column by column.

    Raises:
        ExportError: it has an operation that is not known here.
    """
    flat = function if function.is_a("SXFunction") else function.expand()
    tape = Instructions(flat)
    inputs = [[name, size] for name, size in zip(function.name_in(), tape.rows_in, strict=True)]
    outputs = [[name, *shape] for name, shape in zip(function.name_out(), tape.shapes_out, strict=True)]
    listed = ",".join(f'["{name}",{size}]' for name, size in inputs)
    shapes = ",".join(f'["{name}",{rows},{columns}]' for name, rows, columns in outputs)
    pieces, kept = _pieces(tape)
    bodies = ",\n".join(f"function(i,o,w){{{body}}}" for body in pieces)
    return f"graph([{listed}],[{shapes}],{kept},[\n{bodies}])"


def _pieces(tape: Instructions) -> tuple[list[str], int]:
    """Bodies of the functions that run one after the other, and how many numbers they pass on."""
    count = len(tape.instructions)
    uses, last = Counter[int](), dict[int, int]()
    for k, (operation, first, second) in enumerate(tape.instructions):
        for operand in _operands(operation, first, second):
            uses[operand] += 2 if operation in _TWICE else 1
            last[operand] = k // PIECE
    for node, _, _ in tape.results:
        uses[node] += 1
    slots, bodies = dict[int, int](), list[str]()
    for start in range(0, max(count, 1), PIECE):
        bodies.append(_body(tape, start, min(start + PIECE, count), uses, last, slots))
    return bodies, len(slots)


def _operands(operation: int, first: int, second: int) -> tuple[int, ...]:
    if operation in (ca.OP_CONST, ca.OP_INPUT):
        return ()
    return (first,) if "{1}" not in _form(operation) else (first, second)


def _body(
    tape: Instructions, start: int, end: int, uses: Counter[int], last: dict[int, int], slots: dict[int, int]
) -> str:
    """One piece: values of earlier ones out of `w`, its own as variables, those of later ones into `w`."""
    written: dict[int, tuple[str, int]] = {}
    lines: list[str] = []
    results: dict[int, list[tuple[int, int]]] = {}
    for node, output, element in tape.results:
        results.setdefault(node, []).append((output, element))

    def text(node: int) -> tuple[str, int]:
        if node not in written:
            operation, first, second = tape.instructions[node]
            if operation == ca.OP_CONST:
                written[node] = _number(tape.constants[node]), 0
            elif operation == ca.OP_INPUT:
                # Inputs are read where they are asked for, in every piece.
                written[node] = f"v{node}", 0
                lines.append(f"v{node}=i[{first}][{second}]")
            else:
                written[node] = f"v{node}", 0
                lines.append(f"v{node}=w[{slots[node]}]")
        return written[node]

    out: list[str] = []
    for node in range(start, end):
        operation, first, second = tape.instructions[node]
        if operation in (ca.OP_CONST, ca.OP_INPUT):
            for output, element in results.get(node, ()):
                out.append(f"o[{output}][{element}]={text(node)[0]}")
            continue
        parts = [text(operand) for operand in _operands(operation, first, second)]
        expression = _form(operation).format(*(part for part, _ in parts))
        depth = 1 + max(depth for _, depth in parts)
        later = last.get(node, -1) > node // PIECE
        if uses[node] == 1 and not later and node not in results and depth < DEPTH:
            written[node] = expression, depth
            continue
        written[node] = f"v{node}", 0
        lines.append(f"v{node}={expression}")
        if later:
            slots[node] = len(slots)
            out.append(f"w[{slots[node]}]=v{node}")
        for output, element in results.get(node, ()):
            out.append(f"o[{output}][{element}]=v{node}")
    declared = f"var {','.join(lines)};" if lines else ""
    return declared + ";".join(out)


def _form(operation: int) -> str:
    if operation not in _FORMS:
        raise ExportError(f"explore: CasADi's operation {operation} has no equivalent in JavaScript here")
    return _FORMS[operation]


def _number(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "Infinity" if value > 0 else "(-Infinity)"
    shown = repr(int(value)) if value == int(value) and abs(value) < 2**53 else repr(value)
    return f"({shown})" if value < 0 else shown
