"""Numbers of a page against Python's: what Node or a browser computes with the page's own scripts, and the oracle.

Python's side is `evaluate`-like: `Measures.values`, `LoopPoint` and `Plant`, which share no line with the JavaScript.
"""

from __future__ import annotations

import json
import re
import subprocess
from typing import Any

import numpy as np

import flexopt
from flexopt.explorer.exploring import Explorer
from flexopt.loop.evaluation import settings_at
from flexopt.loop.outcome import LoopPoint
from flexopt.model import AnyMachine
from flexopt.model.uncertainty import SPRINGS, parameters_of
from flexopt.plant import build_plant

# What a case asks, of both: in configuration (base, posture), with springs times `soil`, gains times `gain`.
ASK = """
(cases) => {
  const model = new Model(DATA, GRAPHS), loop = new Loop(model);
  return cases.map(({ base, posture, soil, payload, gain, deadTime }) => {
    model.setParameters(soil, payload);
    const [b, q] = [Float64Array.from(base), Float64Array.from(posture)];
    const modes = model.modes(b, q), numbers = { dead_time: deadTime };
    for (const name of ["kp", "kv", "ki"]) numbers[name] = DATA.loop.numbers[name].map((x) => gain * x);
    const verdict = loop.verdict(b, q, numbers);
    const rest = model.rest(b, q).slice();
    return {
      omega: modes.map((x) => x.omega), w: modes.map((x) => x.w), size: modes.map((x) => x.size),
      zeta: modes.map((x) => x.zeta), decay: verdict.decay, hz: verdict.hz, rounding: verdict.rounding,
      r: [...model.endPoint(b, q)], points: [...model.skeleton(rest, b)],
    };
  });
}
"""


def model_script(page: str) -> str:
    """The part of a page that computes."""
    found = re.search(r'<script id="model">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return found.group(1)


def by_node(page: str, cases: list[dict[str, Any]], node: str = "node") -> list[dict[str, Any]]:
    """What the page's scripts give, run by Node."""
    text = f"{model_script(page)}\nconst found = ({ASK})({json.dumps(cases)});\nconsole.log(JSON.stringify(found));"
    done = subprocess.run([node, "-"], input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def random_cases(machine: AnyMachine, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """Regular configurations within the limits, and numbers of soil, payload and loop."""
    rng, plant = np.random.default_rng(seed), build_plant(machine)
    whole = {"rad": np.pi, "m": 1.0}
    ends = [
        (max(limits[0], -whole[unit]), min(limits[1], whole[unit]))
        for limits, unit in zip(machine.limits, machine.joint_units, strict=True)
    ]
    low, high = np.array(ends).T
    cases: list[dict[str, Any]] = []
    while len(cases) < count:
        posture, base = rng.uniform(low, high), rng.uniform(-2, 2, len(machine.base_coordinates))
        if float(plant.singularity_sine_squared(base, posture, plant.parameter_values)) < 0.01:
            continue
        numbers = {"soil": float(10 ** rng.uniform(-0.5, 0.5)), "payload": float(rng.uniform(0, 500)),
                   "gain": float(10 ** rng.uniform(-1, 1)), "deadTime": float(rng.uniform(0, 0.05))}  # fmt: skip
        cases.append({"base": base.tolist(), "posture": posture.tolist()} | numbers)
    return cases


def by_python(
    machine: AnyMachine, explorer: Explorer, cases: list[dict[str, Any]], *, gravity: bool = False
) -> list[dict[str, Any]]:
    """The same by the package."""
    base, posture = next(iter(explorer.configurations.values()))
    settings, _ = settings_at(machine, posture, base, None, None, gravity=gravity, call="test")
    plant, measures = build_plant(machine), flexopt.build_measures(machine, settings.control, gravity)
    names = [parameter.name for parameter in machine.parameters]
    springs, payload = list(parameters_of((SPRINGS,), machine)), names.index("payload.mass")
    found: list[dict[str, Any]] = []
    for case in cases:
        p = plant.parameter_values.full().ravel()
        p[springs] *= case["soil"]
        p[payload] = case["payload"]
        at = (np.array(case["base"]), np.array(case["posture"]), p)
        values = measures.values(*at)
        values = dict(zip(measures.values.name_out(), values, strict=True))
        sizes = measures.w(*at)[1].full().ravel()
        motions = settings.motions(machine, gravity=gravity)
        given = settings.numbers | {"base": at[0], "posture": at[1], "p": p}
        given |= {name: case["gain"] * given[name] for name in ("kp", "kv", "ki")}
        point = LoopPoint(motions, motions.numbers(given), case["deadTime"])
        loop = point.loop
        q = values["q"].full().ravel()
        found.append({
            "omega": np.sqrt(values["omega_squared"].full().ravel()), "w": values["w"].full().ravel(), "size": sizes,
            "zeta": values["zeta"].full().ravel(), "decay": point.decay().value, "hz": loop.frequency_hz,
            "rounding": loop.rounding, "r": values["end_point"].full().ravel(),
            "points": plant.skeleton(q, at[0], p).full().ravel(order="F"),
        })  # fmt: skip
    return found


def deviations(browser: list[dict[str, Any]], python: list[dict[str, Any]]) -> dict[str, float]:
    """The largest relative deviation of each quantity; w_i relative to |a_i||b_i|, of which it is a part."""
    worst: dict[str, float] = {}
    for one, two in zip(browser, python, strict=True):
        for name, value in two.items():
            if name in ("rounding", "hz"):
                continue
            x, y = np.array(one[name], dtype=float), np.array(value, dtype=float)
            scale = np.abs(y)
            if name == "w":
                scale = np.array(two["size"])
            elif name in ("r", "points"):
                scale = np.full_like(y, np.abs(y).max())
            elif name == "decay":
                # What Python itself says a rate may be off, `SampledLoop.rounding`, counts as 1e-9.
                own = float(np.abs(x - y) / two["rounding"])
                worst["decay / rounding"] = max(worst.get("decay / rounding", 0.0), own)
                worst["decay, strictly"] = max(worst.get("decay, strictly", 0.0), float(np.max(np.abs(x - y) / scale)))
                scale = np.maximum(scale, 1e9 * two["rounding"])
            worst[name] = max(worst.get(name, 0.0), float(np.max(np.abs(x - y) / scale)))
    return worst
