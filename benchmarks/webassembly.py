"""The explorer's graphs as WebAssembly against its JavaScript: `python -m benchmarks.webassembly`.

The same graphs as C by CasADi's generator, by `zig cc` (extra `compiler`) to WebAssembly, run in the same page in turns
with its JavaScript: µs for one call, the least of several rounds, and the largest relative deviation of any output.
`solve` is a cell of the map of w_i, `verdict` one of the decay, `place` what a drag asks for; a frame has one of these
two. Why the explorer has no WebAssembly: docs/howto/explorer.md. Needs chromium and the extra `test`.
"""

from __future__ import annotations

import argparse
import base64
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import casadi as ca

import flexopt
from benchmarks.explorer import MACHINES
from benchmarks.timing import table
from flexopt.explorer.graphs import explorer_functions
from flexopt.loop.evaluation import settings_at
from flexopt.model import AnyMachine
from flexopt.robustness.measures import build_measures
from tests.browser import browser_of
from tests.explorer.browser import opened

MEASURED = """
([text, layout, rounds]) => {
  const begun = performance.now(), module = new WebAssembly.Module(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)));
  const imports = {};
  for (const { module: from, name } of WebAssembly.Module.imports(module)) (imports[from] ??= {})[name] = () => 0;
  const { exports } = new WebAssembly.Instance(module, imports), built = performance.now() - begun;
  exports._initialize?.();
  let top = (exports.__heap_base.value + 15) & ~15;
  const take = (bytes) => { const at = top; top += (bytes + 15) & ~15; return at; };
  const places = Object.fromEntries(Object.entries(layout).map(([name, f]) => [name, {
    i: f.in.map(([, size]) => take(8 * size)), o: f.out.map(([, size]) => take(8 * size)),
    arg: take(4 * f.arg), res: take(4 * f.res), iw: take(4 * f.iw), w: take(8 * f.w) }]));
  exports.memory.grow(Math.max(0, Math.ceil((top - exports.memory.buffer.byteLength) / 65536)));
  const { buffer } = exports.memory, { model, loop, base, posture } = explorer, written = model.graphs;
  const graphs = { ...written }, cases = {};
  for (const [name, f] of Object.entries(layout)) {
    const { i, o, arg, res, iw, w } = places[name], run = exports[name];
    new Uint32Array(buffer, arg, i.length).set(i);
    new Uint32Array(buffer, res, o.length).set(o);
    const views = i.map((at, k) => new Float64Array(buffer, at, f.in[k][1]));
    const named = Object.fromEntries(f.out.map(([key, size], k) => [key, new Float64Array(buffer, o[k], size)]));
    const called = (inputs) => {
      views.forEach((view, k) => view.set(inputs[k]));
      run(arg, res, iw, w, 0);
      return named;
    };
    graphs[name] = { ...written[name], run: called };
  }
  const known = { q: explorer.rest, base, posture, p: model.p };
  let worst = 0;
  for (const [name, f] of Object.entries(layout)) {
    const other = (size) => Float64Array.from({ length: size }, (_, k) => 0.3 + 0.1 * k);
    const inputs = f.in.map(([key, size]) => known[key] ?? other(size));
    const [one, two] = [written, graphs].map((set) => set[name].run(inputs));
    for (const key of Object.keys(one)) {
      const scale = Math.max(...one[key].map(Math.abs));
      one[key].forEach((x, k) => {
        const apart = Math.abs(x - two[key][k]) / (scale || 1);
        if (!(apart <= worst)) worst = apart;
      });
    }
  }
  const near = (k) => Float64Array.from(posture, (x, j) => x + 1e-3 * ((k * (j + 1)) % 97) / 97);
  const calls = {
    reduced: [20000, (k) => model.about("reduced", base, near(k))],
    solve: [10000, (k) => model.solve(base, near(k))],
    verdict: [200, (k) => loop.verdict(base, near(k), explorer.gains, true)],
    place: [2000, (k) => model.place(explorer.target.map((x) => x + 1e-3 * (k % 10)), base, posture)],
  };
  for (const [name, [count, call]] of Object.entries(calls)) {
    const least = [Infinity, Infinity];
    for (let round = 0; round < 2 * rounds; round++) {
      model.graphs = round % 2 ? graphs : written;
      const start = performance.now();
      for (let k = 0; k < count; k++) call(k);
      least[round % 2] = Math.min(least[round % 2], (performance.now() - start) / count * 1e3);
    }
    cases[name] = least;
  }
  model.graphs = written;
  return { cases, worst, built };
}
"""


def compiled(machine: AnyMachine, functions: dict[str, ca.Function], folder: Path) -> tuple[bytes, dict[str, Any]]:
    """The graphs as one module, and where each has its inputs and outputs."""
    code, layout = ca.CodeGenerator("graphs.c", {"casadi_int": "int"}), dict[str, Any]()
    for name, function in functions.items():
        at = function.sx_in()
        flat = ca.Function(name, at, function.call(at), function.name_in(), function.name_out())
        code.add(flat)
        layout[name] = {
            "in": [[key, flat.numel_in(k)] for k, key in enumerate(flat.name_in())],
            "out": [[key, flat.numel_out(k)] for k, key in enumerate(flat.name_out())],
            "arg": flat.sz_arg(), "res": flat.sz_res(), "iw": flat.sz_iw(), "w": flat.sz_w(),
        }  # fmt: skip
    source, module = folder / f"{machine.name}.c", folder / f"{machine.name}.wasm"
    source.write_text(code.dump())
    linked = ["--export=__heap_base", "--strip-all", *(f"--export={name}" for name in functions)]
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi", "-O2", "-mexec-model=reactor"]
    command += ["-ffp-contract=off", *(f"-Wl,{word}" for word in linked), "-o", str(module), str(source), "-lm"]
    subprocess.run(command, check=True)
    return module.read_bytes(), layout


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="of both in turns")
    options = parser.parse_args()
    if not find_spec("ziglang"):
        parser.error("needs the ziglang package: pip install flexopt[compiler]")
    rows: list[tuple[str, ...]] = [
        ("machine", "call", "JavaScript µs", "WebAssembly µs", "ratio", "module kB", "loaded ms", "deviation")
    ]
    with browser_of() as browser, tempfile.TemporaryDirectory() as place:
        for name in MACHINES:
            machine = flexopt.load(name)
            explorer = flexopt.explore(machine, [1.0, -2.0] if name == "excavator" else None)
            base, posture = explorer.configurations["present"]
            settings, _ = settings_at(machine, posture, base, None, None, gravity=False, call="webassembly")
            measures, motions = build_measures(machine, settings.control), settings.motions(machine, gravity=False)
            functions = explorer_functions(measures, motions, frames=bool(machine.capsules))
            module, layout = compiled(machine, functions, Path(place))
            with opened(browser, explorer, Path(place)) as page:
                page.locator("#motion").select_option("off")
                page.wait_for_function("explorer.map.job === null && explorer.map.shown !== null")
                found = page.evaluate(MEASURED, [base64.b64encode(module).decode(), layout, options.rounds])
            more = (f"{len(module) / 1e3:.0f}", f"{found['built']:.0f}", f"{found['worst']:.0e}")
            for call, (script, wasm) in found["cases"].items():
                rows.append((name, call, f"{script:.2f}", f"{wasm:.2f}", f"{script / wasm:.2f}", *more))
    print(table("The explorer's graphs as JavaScript and as WebAssembly", rows))


if __name__ == "__main__":
    main()
