"""C++ source that evaluates a Function at several points at once.

In: a CasADi Function whose inputs and outputs are dense columns. Out: the text of a translation unit with one exported
`kernel`. CasADi's own C generator writes the evaluation; `lane.hpp` supplies the type that takes the place of `double`.
What the generator writes is cut down to the functions that are reached, so that helpers which branch on numbers, but
are never called, do not keep a graph from compiling.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files

import casadi as ca

# Helpers of the generated code that `lane.hpp` has under another name.
_OWN = {
    "casadi_sq": "sq", "casadi_fabs": "fabs", "casadi_fmin": "fmin", "casadi_fmax": "fmax", "casadi_sign": "sign",
    "casadi_expm1": "expm1", "casadi_log1p": "log1p", "casadi_hypot": "hypot", "casadi_if_else": "select",
}  # fmt: skip
_VALUE = r"\(\*\w+(?:\+\+)?\)|\*\w+|\w+(?:\[\w+\])?"
_CHOICE = re.compile(rf"\(({_VALUE})\?({_VALUE}):0\)")
_NAME = re.compile(r"\bcasadi_\w+")

_KERNEL = """
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

// Points begin .. end-1. rows[k]: values of input nonzero k, one a point, or a single one where fixed[k].
// results[k]: where output nonzero k goes, one a point. Returns 0, or what the generated function returned.
extern "C" EXPORT int flexopt_kernel(const double *const *rows, const unsigned char *fixed, double *const *results,
                                     long long begin, long long end) {
  enum { IN = @IN@, OUT = @OUT@, WORK = @WORK@ };
  void *memory = __builtin_malloc(sizeof(lane) * (IN + OUT + WORK + 1));
  if (!memory) return -1;
  lane *x = (lane *)(((unsigned long long)memory + sizeof(lane) - 1) & ~(unsigned long long)(sizeof(lane) - 1));
  lane *y = x + IN, *w = y + OUT;
  int status = 0, n_moving = 0, moving[IN + 1];
  for (int k = 0; k < IN; ++k) {
    if (fixed[k]) x[k] = lane(rows[k][0]);
    else moving[n_moving++] = k;
  }
  for (long long i = begin; i < end && !status; i += LANES) {
    bool full = end - i >= LANES;
    for (int j = 0; j < n_moving; ++j) {
      const double *row = rows[moving[j]];
      if (full) x[moving[j]] = vec(*(const loose *)(row + i));
      else for (int l = 0; l < LANES; ++l) x[moving[j]].v[l] = row[i + l < end ? i + l : end - 1];
    }
    const lane *arg[@SZ_ARG@ + 1] = {@ARG@};
    lane *res[@SZ_RES@ + 1] = {@RES@};
    casadi_int iw[@SZ_IW@ + 1];
    status = @NAME@(arg, res, iw, w, 0);
    for (int k = 0; k < OUT; ++k) {
      if (full) *(loose *)(results[k] + i) = y[k].v;
      else for (int l = 0; i + l < end; ++l) results[k][i + l] = y[k].v[l];
    }
  }
  __builtin_free(memory);
  return status;
}
"""


def kernel_source(function: ca.Function) -> str:
    """The translation unit; whether it compiles decides whether the Function can be batched."""
    head = [_resource("lane.hpp"), _resource("lane_math.hpp")]
    head += ["typedef lane casadi_real;", "typedef long long casadi_int;"]
    head += [f"#define {theirs} {ours}" for theirs, ours in _OWN.items()]
    head += ["#define casadi_inf __builtin_inf()", '#define casadi_nan __builtin_nan("")']
    body, name = _generated(function)
    return "\n".join([*head, body, _kernel(function, name)])


@cache
def _resource(name: str) -> str:
    return files("flexopt.compiled").joinpath(name).read_text(encoding="utf-8")


def _generated(function: ca.Function) -> tuple[str, str]:
    """The definitions that the Function's evaluation reaches, and the name of that evaluation."""
    generator = ca.CodeGenerator("flexopt_generated", {"with_export": False, "include_math": False})
    generator.add(function)
    pieces = _pieces(_CHOICE.sub(r"select(\1,\2,0)", generator.dump()))
    exported = pieces[function.name()]
    match = re.search(r"return (casadi_\w+)\(", exported)
    assert match is not None, exported
    reached = _reached(pieces, match[1])
    return "\n".join(text for name, text in pieces.items() if name in reached), match[1]


def _pieces(text: str) -> dict[str, str]:
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


def _reached(pieces: dict[str, str], root: str) -> set[str]:
    reached, waiting = {root}, [root]
    while waiting:
        for name in set(_NAME.findall(pieces[waiting.pop()])) - reached:
            if name in pieces and name not in _OWN:
                reached.add(name)
                waiting.append(name)
    return reached


def _kernel(function: ca.Function, name: str) -> str:
    """The exported loop over the points."""
    arg, offset = list[str](), 0
    for k in range(function.n_in()):
        arg.append(f"x + {offset}")
        offset += function.nnz_in(k)
    n_in = offset
    res, offset = list[str](), 0
    for k in range(function.n_out()):
        res.append(f"y + {offset}")
        offset += function.nnz_out(k)
    values = {
        "IN": n_in, "OUT": offset, "WORK": function.sz_w(), "SZ_ARG": function.sz_arg(), "SZ_RES": function.sz_res(),
        "SZ_IW": function.sz_iw(), "ARG": ", ".join(arg), "RES": ", ".join(res), "NAME": name,
    }  # fmt: skip
    return re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), _KERNEL)
