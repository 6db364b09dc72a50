"""C++ source that evaluates a Function at several points, or runs a recurrence for several members, at once.

In: CasADi Functions; those of a recurrence have dense columns. Out: the text of a translation unit with one exported
function. CasADi's own C generator writes the evaluation; `lane.hpp` supplies the type that takes the place of `double`.
What the generator writes is cut down to the functions that are reached, so that helpers which branch on numbers, but
are never called, do not keep a graph from compiling.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from functools import cache
from importlib.resources import files

import casadi as ca

from flexopt.compiled.fused import fused, straight
from flexopt.compiled.pieces import LONG, beforehand, in_pieces
from flexopt.foundation.kernels import DENSE_PRODUCT, SYMMETRIC_SUM

# Helpers of the generated code that `lane.hpp` has under another name.
_OWN = {
    "casadi_sq": "sq", "casadi_fabs": "fabs", "casadi_fmin": "fmin", "casadi_fmax": "fmax", "casadi_sign": "sign",
    "casadi_expm1": "expm1", "casadi_log1p": "log1p", "casadi_hypot": "hypot", "casadi_if_else": "select",
    "casadi_mtimes_dense": "add_product", "casadi_norm_inf": "largest",
}  # fmt: skip
_VALUE = r"\(\*\w+(?:\+\+)?\)|\*\w+|\w+(?:\[\w+\])?"
_CHOICE = re.compile(rf"\(({_VALUE})\?({_VALUE}):0\)")
_NAME = re.compile(r"\bcasadi_\w+")
# A call that is chosen by a number, and the outputs of the function that makes it, by the comment before it.
_CHOSEN = "arg[0] ? casadi_to_int(*arg[0]) : 0"
_OUTPUT = re.compile(r"o\d+(?:\[(\d+)(?:x(\d+))?(?:,(\d+)nz)?\])?")

# Lines of the longest generated function and how hard to optimise them. Of lanes, which are structures, gcc's scalar
# replacement of aggregates takes a time that grows with the square of the length; without it the code is 15 % slower.
# Straight-line functions longer than the first come in pieces.
LEVELS = ((LONG, ("-O2",)), (20_000, ("-O2", "-fno-tree-sra")), (40_000, ("-O1", "-fno-tree-sra")))
LINES_MAX = 200_000
# Functions of no more statements than this take two groups of points side by side: a third faster, where a longer one
# would only keep more in memory.
SHORT = 1000

# CasADi writes a graph depth first. Scheduling it before registers are assigned, which gcc leaves out on x86, makes the
# code 5 to 15 % faster and changes no result.
_SCHEDULED = '#pragma GCC optimize("schedule-insns", "sched-pressure")'

# Nothing is fused but what `fused` writes, so that kernels of both widths give the same bits.
_NOT_FUSED = """#if defined(__clang__)
#pragma clang fp contract(off)
#else
#pragma GCC optimize("fp-contract=off")
#endif"""

_TYPES = "typedef lane casadi_real;\ntypedef long long casadi_int;"

_EXPORT = """
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
extern "C" EXPORT int flexopt_lanes() { return LANES; }
"""

_KERNEL = """
// Points begin .. end-1. rows[k]: values of input nonzero k, one a point, or a single one where fixed[k].
// results[k]: where output nonzero k goes, one a point. Returns 0, or what the generated function returned.
extern "C" EXPORT int flexopt_kernel(const double *const *rows, const unsigned char *fixed, double *const *results,
                                     long long begin, long long end) {
  enum { IN = @IN@, OUT = @OUT@, WORK = @WORK@, TOGETHER = sizeof(lane) / sizeof(double) };
  void *memory = __builtin_malloc(sizeof(lane) * (IN + OUT + WORK + 1));
  if (!memory) return -1;
  lane *x = (lane *)(((unsigned long long)memory + sizeof(::vec) - 1) & ~(unsigned long long)(sizeof(::vec) - 1));
  lane *y = x + IN, *w = y + OUT;
  int status = 0, n_moving = 0, moving[IN + 1];
  for (int k = 0; k < IN; ++k) {
    if (fixed[k]) x[k] = lane(rows[k][0]);
    else moving[n_moving++] = k;
  }
@ONCE@
  for (long long i = begin; i < end && !status; i += TOGETHER) {
    const long long here = end - i < TOGETHER ? end - i : TOGETHER;
    for (int j = 0; j < n_moving; ++j) {
      const double *row = rows[moving[j]] + i;
      if (here == TOGETHER) __builtin_memcpy(&x[moving[j]], row, sizeof(lane));
      else for (int l = 0; l < TOGETHER; ++l) ((number *)&x[moving[j]])[l] = row[l < here ? l : here - 1];
    }
    const lane *arg[@SZ_ARG@ + 1] = {@ARG@};
    lane *res[@SZ_RES@ + 1] = {@RES@};
    casadi_int iw[@SZ_IW@ + 1];
    @EACH@status = @NAME@(arg, res, iw, w, 0);
    for (int k = 0; k < OUT; ++k) {
      if (here == TOGETHER) __builtin_memcpy(results[k] + i, &y[k], sizeof(lane));
      else for (int l = 0; l < here; ++l) results[k][i + l] = ((const number *)&y[k])[l];
    }
  }
  __builtin_free(memory);
  return status;
}
"""

_ONCE = """  bool still = true;
  for (int k = {first}; k < {last}; ++k) still &= fixed[k] != 0;
  const lane *given[] = {{{arg}}};
  if (still) {name}_before(given, w);"""

# A Function of two dense matrices by the comment before it, and the call of `lane.hpp` that its definition becomes.
_OF_MATRICES = re.compile(
    rf"(/\* ({DENSE_PRODUCT}|{SYMMETRIC_SUM}):\(i0\[(\d+)x(\d+)\],i1\[\d+x(\d+)\]\)->"
    r"\(o0\[\d+x\d+\]\) \*/\n[^\n]*\n).*?\n\}\n", re.DOTALL
)  # fmt: skip
_BY_KERNEL = r"""\1  if (res[0]) \2(arg[0], \3, \4, arg[1], \5, res[0]);
  return 0;
}
"""

# A chosen call for points that choose differently: their results are put together from one call for each choice.
_BY_LANE = """static int @NAME@(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  if (!arg[0] || unanimous(*arg[0])) return @NAME@_one(arg, res, iw, w, arg[0] ? first_choice(*arg[0]) : 0);
  casadi_real other[@SIZE@ + 1], *apart[@SZ_RES@ + 1], *next = other;
  const casadi_int sizes[@N@ + 1] = { @SIZES@ }, *size = sizes;
  for (int i = 0; i < @N@; next += *size++) apart[i++] = next;
  return each_choice(@NAME@_one, arg, res, apart, sizes, @N@, iw, w);
}"""


def kernel_source(function: ca.Function) -> str:
    """The translation unit; whether it compiles decides whether the Function can be batched."""
    texts, name = _generated(function)
    alone = straight(texts[0]) if len(texts) == 1 else None
    if alone is None or len(alone.texts) > SHORT:
        return "\n".join([_head(), _TYPES, *map(_written, texts), _kernel(function, name)])
    given = max(range(function.n_in()), key=function.nnz_in, default=0)
    before, rest, size = beforehand(fused(alone), given)
    paired = ["namespace paired {", _TYPES, before, rest, _kernel(function, name, given, size), "}"]
    return "\n".join([_head(), _resource("lane_pair.hpp"), *paired])


def recurrence_source(functions: Mapping[str, ca.Function], sizes: Mapping[str, int], *, narrow: bool) -> str:
    """The translation unit of a recurrence.

    Args:
        functions: `step` and, if there is a fast step, `fast` and `refresh`; their inputs and outputs dense columns.
        sizes: the numbers of rows, by their names in `recurrence.hpp`.
        narrow: whether it is meant for so few members that half of the widest vectors hold them; same bits.
    """
    work = max(function.sz_w() for function in functions.values())
    constants = dict(sizes) | {"WORK": work}
    lines = [_NOT_FUSED, *(["#define NARROW"] if narrow else []), _head(), _TYPES]
    lines.append(f"#define FAST {int('fast' in functions)}")
    lines.append("enum { " + ", ".join(f"{name} = {value}" for name, value in constants.items()) + " };")
    lines += [_call(name, function) for name, function in functions.items()]
    return "\n".join([*lines, _resource("recurrence.hpp")])


def _head() -> str:
    lines = [_SCHEDULED, _resource("lane.hpp"), _resource("lane_math.hpp"), _EXPORT]
    lines += [f"#define {theirs} {ours}" for theirs, ours in _OWN.items()]
    lines += ["#define casadi_inf __builtin_inf()", '#define casadi_nan __builtin_nan("")']
    lines.append("#define CASADI_CAST(type, x) ((type)(x))")
    return "\n".join(lines)


def _call(name: str, function: ca.Function) -> str:
    """The Function in a namespace of its own, and `call_name(inputs…, outputs…, w)`."""
    texts, generated = _generated(function)
    body = "\n".join(map(_written, texts))
    inputs, outputs = [
        [f"{kind}{k}" for k in range(n)] for kind, n in (("i", function.n_in()), ("o", function.n_out()))
    ]
    parameters = [f"const lane *{i}" for i in inputs] + [f"lane *{o}" for o in outputs]
    return f"""namespace {name}_graph {{
{body}
}}
INLINE int call_{name}({", ".join(parameters)}, lane *w) {{
  const lane *arg[{function.sz_arg()} + 1] = {{{", ".join(inputs)}}};
  lane *res[{function.sz_res()} + 1] = {{{", ".join(outputs)}}};
  casadi_int iw[{function.sz_iw()} + 1];
  return {name}_graph::{generated}(arg, res, iw, w, 0);
}}"""


@cache
def _resource(name: str) -> str:
    return files("flexopt.compiled").joinpath(name).read_text(encoding="utf-8")


def _generated(function: ca.Function) -> tuple[list[str], str]:
    """The definitions that the Function's evaluation reaches, and the name of that evaluation."""
    generator = ca.CodeGenerator("flexopt_generated", {"with_export": False, "include_math": False})
    generator.add(function)
    text = by_lane(by_kernel(generator.dump()), function.sz_res())
    pieces = definitions(_CHOICE.sub(r"select(\1,\2,0)", text))
    exported = pieces[function.name()]
    match = re.search(r"return (casadi_\w+)\(", exported)
    assert match is not None, exported
    reached = reached_from(pieces, match[1], _OWN)
    return [text for name, text in pieces.items() if name in reached], match[1]


def _written(text: str) -> str:
    """A function as it is compiled."""
    function = straight(text)
    return text if function is None else in_pieces(fused(function))


def by_kernel(text: str) -> str:
    """The text with the Functions of dense matrices that `lane.hpp` has by name done there: in blocks, in one pass."""
    return _OF_MATRICES.sub(_BY_KERNEL, text)


def by_lane(text: str, sz_res: int) -> str:
    """The text with every call that a number chooses (`Function.if_else`, `conditional`) chosen for each point alone.

    Where all points agree, as is the rule, one call serves them; else there is one for each choice, and every point
    takes its own results: they are the same in any company.
    """
    blocks = text.split("\n/* ")
    for k, block in enumerate(blocks):
        if _CHOSEN not in block:
            continue
        signature, _, body = block.partition("\n")
        name = re.search(r"static int (\w+)\(", body)
        assert name is not None, block
        of_one = body.replace(name[1], f"{name[1]}_one", 1).replace("int mem)", "casadi_int chosen)", 1)
        sizes = [_entries(match) for match in _OUTPUT.finditer(signature.partition("->")[2])]
        values = {"NAME": name[1], "SIZE": sum(sizes), "SZ_RES": sz_res, "N": len(sizes)}
        values |= {"SIZES": ", ".join(map(str, sizes))}
        wrapped = re.sub(r"@(\w+)@", lambda found, values=values: str(values[found[1]]), _BY_LANE)
        blocks[k] = "\n".join([signature, of_one.replace(_CHOSEN, "chosen").rstrip("\n"), wrapped, ""])
    return "\n/* ".join(blocks)


def _entries(output: re.Match[str]) -> int:
    rows, columns, nonzeros = (int(number) if number else None for number in output.groups())
    return nonzeros if nonzeros is not None else (1 if rows is None else rows) * (1 if columns is None else columns)


def level(source: str) -> tuple[str, ...] | None:
    """How hard to optimise a translation unit, so that compilation takes seconds; None where it would take too long."""
    if source.count("\n") > LINES_MAX:
        return None
    longest = max(block.count("\n") for block in source.split("\n}\n"))
    return next((level for most, level in LEVELS if longest <= most), None)


def brief_level(source: str) -> tuple[str, ...] | None:
    """The same for what runs briefly: compiled in half the time, it takes a seventh longer and gives the same bits."""
    hard = level(source)
    return hard and tuple("-O1" if option == "-O2" else option for option in hard)


def definitions(text: str) -> dict[str, str]:
    """Name -> text of every table, struct and function defined at the left margin, in their order."""
    pieces: dict[str, str] = {}
    lines = iter(text.splitlines())
    for line in lines:
        match = re.match(r"(?!#|/|\s|typedef|extern|return)[\w *]*?(\w+)(\(|\[| \{)", line)
        if match is None:
            continue
        block = [line]
        while not re.search(r"^\}|^[^ ].*\{.*\}[^{]*$|\};$", block[-1]):
            block.append(next(lines))
        pieces[match[1]] = "\n".join(block)
    return pieces


def reached_from(pieces: dict[str, str], root: str, without: Container[str] = ()) -> set[str]:
    """Names of the pieces that `root` reaches, itself among them, leaving aside those in `without`."""
    reached, waiting = {root}, [root]
    while waiting:
        for name in set(_NAME.findall(pieces[waiting.pop()])) - reached:
            if name in pieces and name not in without:
                reached.add(name)
                waiting.append(name)
    return reached


def _kernel(function: ca.Function, name: str, given: int = 0, kept: int = 0) -> str:
    """The exported loop over the points; `kept`: how many values are computed of input `given`, once if it is fixed."""
    arg, offsets = list[str](), [0]
    for k in range(function.n_in()):
        arg.append(f"x + {offsets[-1]}")
        offsets.append(offsets[-1] + function.nnz_in(k))
    res, offset = list[str](), 0
    for k in range(function.n_out()):
        res.append(f"y + {offset}")
        offset += function.nnz_out(k)
    once = each = ""
    if kept:
        once = _ONCE.format(first=offsets[given], last=offsets[given + 1], arg=", ".join(arg), name=name)
        each = f"if (!still) {name}_before(arg, w);\n    "
    values = {
        "IN": offsets[-1], "OUT": offset, "WORK": max(function.sz_w(), kept), "SZ_ARG": function.sz_arg(),
        "SZ_RES": function.sz_res(), "SZ_IW": function.sz_iw(), "ARG": ", ".join(arg), "RES": ", ".join(res),
        "NAME": name, "ONCE": once, "EACH": each,
    }  # fmt: skip
    return re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), _KERNEL)
