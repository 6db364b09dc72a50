"""What the page computes against what Python computes, at random configurations, in Chromium and, where it is, Node."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from playwright.sync_api import Browser
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

import flexopt
from flexopt.errors import InputError
from flexopt.explorer.javascript import PIECE, script_of
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import SPRINGS, parameters_of
from tests.explorer.browser import POSTURE, drag, explored, opened, settled, state
from tests.explorer.numbers import ASK, by_node, by_python, deviations, model_script, random_cases

MACHINES = ("excavator", "boom-stick-bucket", "slewing-excavator")
NODE = shutil.which("node")


@pytest.mark.needs("node")
@pytest.mark.parametrize(("name", "posture"), [("excavator", POSTURE), ("boom-stick-bucket", [-1.0, -1.5, -1.0])])
def test_the_gain_from_which_a_mode_grows_is_pythons(name: str, posture: list[float]) -> None:
    """κ of equal gains; of velocity-served joints with their servos' damping, as `flexopt.outcome` has it."""
    machine = flexopt.load(name)
    known, page = flexopt.outcome(machine, posture), flexopt.explore(machine, posture).page
    assert known.settings.drive == ("torque" if name == "excavator" else "velocity")
    at = json.dumps([[0.0], posture])
    text = f"{model_script(page)}\nconst at = {at}.map((x) => Float64Array.from(x));\n"
    text += "const found = new Model(DATA, GRAPHS).modes(...at);\n"
    text += "console.log(JSON.stringify(found.map((mode) => mode.kappa)));"
    done = subprocess.run(["node", "-"], input=text, capture_output=True, text=True, check=True)
    found = [math.inf if kappa is None else kappa for kappa in json.loads(done.stdout)]
    assert math.inf > min(found)
    np.testing.assert_allclose(found, known.allowance_isotropic, rtol=1e-9)


TORQUES = {"drive": "torque", "kp": 2e5, "kv": 3e4, "rate": 200.0}
SERVED = {"drive": "velocity", "kp": 1.0, "kv": 0.01, "rate": 100.0}


@pytest.mark.needs("node")
@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize(
    ("name", "loop"),
    [
        ("excavator", TORQUES),
        ("excavator", TORQUES | {"dead_time": 0.005, "filter_hz": 20.0, "bandwidth_hz": 5.0, "feedback": "pid", "ki": 10}),
        ("excavator", SERVED | {"servo_gain": 1e5, "dead_time": 0.033}),
        ("excavator", SERVED | {"servo_gain": 1e8}),
        ("boom-stick-bucket", TORQUES | {"dead_time": 0.0123}),
        pytest.param("slewing-excavator", TORQUES, marks=pytest.mark.long),
        pytest.param("slewing-excavator", SERVED | {"servo_gain": 1e6, "dead_time": 0.03}, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_what_modes_have_become_is_pythons(name: str, loop: dict[str, Any], gravity: bool) -> None:
    """The decay of each, to first order and exactly, and where the first order fails."""
    machine = flexopt.load(name)
    explorer = flexopt.explore(machine, POSTURE if name == "excavator" else None, loop=loop, gravity=gravity)
    base, posture = explorer.configurations["present"]
    known = flexopt.outcome(machine, posture, base=base, loop=loop, gravity=gravity)
    at = json.dumps([base.tolist(), posture.tolist()])
    text = f"{model_script(explorer.page)}\nconst at = {at}.map((x) => Float64Array.from(x));\n"
    text += "const model = new Model(DATA, GRAPHS), loop = new Loop(model), modes = model.modes(...at);\n"
    text += "const numbers = { ...DATA.loop.numbers, dead_time: DATA.loop.dead_time };\n"
    text += "const verdict = loop.verdict(...at, numbers), found = loop.ofModes(...at, numbers, modes, verdict);\n"
    text += "console.log(JSON.stringify(found));"
    done = subprocess.run(["node", "-"], input=text, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert [each["fails"] for each in found] == known.first_order_fails.tolist()
    for key, values in (("first", known.first_order_decay), ("decay", known.mode_decay)):
        numbers = np.array([math.nan if each[key] is None else each[key] for each in found])
        # Rates are logarithms of eigenvalues near 1.
        np.testing.assert_allclose(numbers, values, rtol=1e-8, atol=known.decay_rounding)


@pytest.mark.needs("node")
@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize(
    "loop",
    [TORQUES, TORQUES | {"nullspace_damping": 1e3}, SERVED | {"servo_gain": 1e5, "nullspace_damping": 5e3, "dead_time": 0.03}],
    ids=["torque", "braked", "served"],
)  # fmt: skip
def test_what_a_redundant_arm_drifts_by_is_pythons(loop: dict[str, Any], gravity: bool) -> None:
    machine, rng = flexopt.load("boom-stick-bucket"), np.random.default_rng(3)
    page = flexopt.explore(machine, loop=loop, gravity=gravity).page
    low, high = np.clip(np.array(machine.limits), -2, 2).T
    postures = rng.uniform(low, high, (12, low.size))
    text = f"{model_script(page)}\nconst model = new Model(DATA, GRAPHS), loop = new Loop(model);\n"
    text += "const numbers = { ...DATA.loop.numbers, dead_time: DATA.loop.dead_time };\n"
    text += f"const found = {json.dumps(postures.tolist())}.map((x) => loop.verdict(new Float64Array(1), Float64Array.from(x), numbers));\n"
    text += "console.log(JSON.stringify(found.map(({ decay, drift }) => ({ decay, drift }))));"
    done = subprocess.run(["node", "-"], input=text, capture_output=True, text=True, check=True)
    told = 0
    for posture, each in zip(postures, json.loads(done.stdout), strict=True):
        known = flexopt.outcome(machine, posture, base=0.0, loop=loop, gravity=gravity)
        # Rates are logarithms of eigenvalues near 1.
        assert each["decay"] == pytest.approx(known.decay, rel=1e-7, abs=10 * known.decay_rounding)
        drift = sorted(each["drift"], reverse=True)
        assert drift == pytest.approx(list(known.drift), rel=1e-6, abs=10 * known.decay_rounding)
        told += len(drift)
    assert told > 0 or not gravity


@pytest.mark.needs("node")
def test_an_assignment_is_scipys() -> None:
    """Rows fewer and more than columns, and none."""
    rng = np.random.default_rng(5)
    values = [
        rng.uniform(size=(rows, columns)) for rows in (1, 3, 6) for columns in (0, 1, 2, 5, 6, 15) for _ in range(5)
    ]
    asked = json.dumps([[each.ravel().tolist(), *each.shape] for each in values])
    script = model_script(explored("excavator")[1].page)
    text = f"{script}\nconsole.log(JSON.stringify({asked}.map((each) => Linear.assignment(...each))));"
    done = subprocess.run(["node", "-"], input=text, capture_output=True, text=True, check=True)
    for each, found in zip(values, json.loads(done.stdout), strict=True):
        pairs = [(i, j) for i, j in enumerate(found) if j >= 0]
        assert pairs == list(zip(*(x.tolist() for x in linear_sum_assignment(-each)), strict=True))


@pytest.mark.long
@pytest.mark.needs("chromium")
@pytest.mark.parametrize("name", MACHINES)
def test_the_browser_computes_what_python_computes(name: str, chromium: Browser, pages: Path) -> None:
    machine, explorer = explored(name)
    cases = random_cases(machine, 25, seed=1)
    with opened(chromium, explorer, pages) as page:
        found = page.evaluate(f"(cases) => ({ASK})(cases)", cases)
        if NODE is not None:
            assert deviations(by_node(explorer.page, cases, NODE), found)["w"] < 1e-9
    known = by_python(machine, explorer, cases)
    worst = deviations(found, known)
    names = ("omega", "w", "size", "zeta", "decay", "r", "points")
    assert max(worst[each] for each in names) < 1e-9, worst
    if name == "excavator":
        assert {value["decay"] > 0 for value in known} == {True, False}


@pytest.mark.long
@pytest.mark.needs("chromium")
@pytest.mark.parametrize("name", MACHINES)
def test_under_the_weight_too(name: str, chromium: Browser, pages: Path) -> None:
    """The machine sags to the same place, and its modes and its loop are those about that place."""
    machine = flexopt.load(name)
    explorer = flexopt.explore(machine, POSTURE if name == "excavator" else None, gravity=True)
    cases = random_cases(machine, 25, seed=2)
    with opened(chromium, explorer, pages) as page:
        found = page.evaluate(f"(cases) => ({ASK})(cases)", cases)
        assert "under the machine's weight" in page.locator("footer").inner_text()
        # Where the end-point is dragged to there it is, with the sag.
        page.locator("#motion").select_option("off")
        drag(page, ".handle.end", 20, -10)
        at = state(page)
    worst = deviations(found, by_python(machine, explorer, cases, gravity=True))
    assert max(worst[each] for each in ("omega", "w", "size", "zeta", "decay", "r", "points")) < 1e-9, worst
    assert worst["w"] < deviations(found, by_python(machine, explorer, cases))["w"]
    under = flexopt.evaluate(machine, at["posture"], base=at["base"], gravity=True)
    assert under.end_point == pytest.approx(at["target"], abs=1e-9)
    assert [mode["w"] for mode in at["modes"]] == pytest.approx(under.w, abs=1e-9 * max(m["size"] for m in at["modes"]))


@pytest.mark.long("slewing-excavator")
@pytest.mark.needs("chromium")
@pytest.mark.parametrize("name", ["excavator", "slewing-excavator"])
def test_payload_and_soil_keep_the_joint_angles(name: str, chromium: Browser, pages: Path) -> None:
    """The end-point goes along with the base as it sags, as `flexopt.evaluate` has it; a drag begins where it was held."""
    machine = flexopt.load(name)
    explorer = flexopt.explore(machine, POSTURE if name == "excavator" else None, gravity=True)
    with opened(chromium, explorer, pages) as page:
        assert "keep the joint angles" in page.locator("#see").inner_text()
        before = state(page)
        for label, value in (("payload", 400.0), ("soil, all springs", -0.3)):
            page.evaluate("""([name, value]) => { const input = document.querySelector(`input[aria-label="${name}"]`);
              input.value = value; input.dispatchEvent(new Event("input")); }""", [label, value])  # fmt: skip
            settled(page)
        after, point = (
            state(page),
            page.evaluate("Array.from(explorer.model.endPoint(explorer.base, explorer.posture))"),
        )
        page.evaluate("explorer.moveEnd(explorer.target)")
        settled(page)
        back = page.evaluate("Array.from(explorer.model.endPoint(explorer.base, explorer.posture))")
    springs = {machine.parameters[k].name: machine.parameters[k].value for k in parameters_of((SPRINGS,), machine)}
    other = {key: value * 10**-0.3 for key, value in springs.items()} | {"payload.mass": 400.0}
    sagged = flexopt.evaluate(with_parameters(machine, other), before["posture"], base=before["base"], gravity=True)
    assert (after["posture"], after["base"], after["target"]) == (before["posture"], before["base"], before["target"])
    assert point == pytest.approx(sagged.end_point, abs=1e-9)
    assert np.linalg.norm(np.subtract(point, before["target"])) > 1e-4
    assert back == pytest.approx(before["target"], abs=1e-9)


@pytest.mark.long
@pytest.mark.needs("chromium")
def test_springs_that_do_not_hold_the_weight(chromium: Browser, pages: Path) -> None:
    """Softer soil by its slider until the machine would fall over: a word, and no number."""
    data = flexopt.load("excavator").to_dict()
    machine = flexopt.machine_from_dict(data | {"gravity": 100.0})
    explorer = flexopt.explore(machine, POSTURE, gravity=True)
    with opened(chromium, explorer, pages) as page:
        assert page.evaluate("explorer.modes !== null")
        page.evaluate("""() => { const input = document.querySelector('input[aria-label="soil, all springs"]');
          input.value = -1; input.dispatchEvent(new Event("input")); }""")
        page.wait_for_function("explorer.modes === null")
        assert "do not hold" in page.locator("#verdict").inner_text()
    soft = flexopt.load("excavator").to_dict() | {"gravity": 100.0}
    soft["base"] = data["base"] | {"stiffness": {key: value / 10 for key, value in data["base"]["stiffness"].items()}}
    with pytest.raises(InputError, match="do not hold"):
        flexopt.evaluate(flexopt.machine_from_dict(soft), POSTURE, gravity=True)


@pytest.mark.long
@pytest.mark.needs("chromium")
def test_a_problem_brings_its_weight(chromium: Browser, pages: Path) -> None:
    problem = flexopt.load_problem("article")
    under = problem.selection.model_copy(update={"gravity": True})
    explorer = flexopt.explore(problem.model_copy(update={"selection": under}))
    with opened(chromium, explorer, pages) as page:
        page.get_by_role("button", name="recommended").click()
        settled(page)
        at = state(page)
    found = flexopt.evaluate(problem.loaded_machine, at["posture"], base=at["base"], gravity=True)
    assert found.end_point == pytest.approx(problem.target.end_point, abs=1e-6)
    assert [mode["hz"] for mode in at["modes"]] == pytest.approx(found.frequencies_hz, rel=1e-9)


@pytest.mark.long
@pytest.mark.needs("chromium")
def test_equal_frequencies_are_one_cluster(chromium: Browser, pages: Path) -> None:
    """An arm that stands straight up on springs alike in x and y: λmin of the cluster's summed residue."""
    data = flexopt.load("excavator").to_dict()
    data["base"]["stiffness"] = {"x": 4e7, "y": 4e7}
    data["base"]["damping"] = {"x": 50.0, "y": 50.0}
    for link in data["links"]:
        link["mass"] = 1e-9 * link["mass"]
        link["inertia"] = 1e-9 * link["inertia"]
    machine = flexopt.machine_from_dict(data)
    explorer = flexopt.explore(machine, [1.0, -2.0], loop={"kp": 1e-4, "kv": 1e-5})
    measures = flexopt.build_measures(machine)
    found = measures.values(0, [1.0, -2.0], measures.plant.parameter_values)
    values = dict(zip(measures.values.name_out(), found, strict=True))
    assert np.all(values["same"].full() == 1)
    with opened(chromium, explorer, pages) as page:
        modes = page.evaluate("explorer.modes")
        assert not any(mode["alone"] for mode in modes)
        found, scale = [mode["w"] for mode in modes], max(mode["size"] for mode in modes)
    assert np.allclose(found, values["w"].full().ravel(), rtol=0, atol=1e-7 * scale)


@pytest.mark.needs("chromium")
def test_every_operation_of_a_graph(chromium: Browser) -> None:
    """Each operation that a graph may have, alone and in one long graph that is cut into pieces."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    each = [
        x + y, x - y, x * y, x / y, -x, 1 / x, 2 * x, x**2, x**y, x**3.5, ca.sqrt(x), ca.sin(x), ca.cos(x), ca.tan(x),
        ca.asin(x / 9), ca.acos(x / 9), ca.atan(x), ca.atan2(x, -y), ca.exp(x), ca.log(x), ca.log1p(x), ca.expm1(x),
        ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.floor(x), ca.ceil(x), ca.fabs(-x), ca.sign(-x), ca.fmin(x, y),
        ca.fmax(x, y), ca.fmod(x, y), ca.hypot(x, y), ca.copysign(x, -y), x < y, x <= y, x == y, x != y,
        ca.logic_not(x < y), ca.logic_and(x < y, y > 0), ca.logic_or(x < y, y > 9), ca.if_else(x < y, x, y),
        ca.SX(-2.5), ca.SX(math.inf), x,
    ]  # fmt: skip
    long = x
    for k in range(2 * PIECE):
        long = ca.sin(long) + y * (1 + 1e-3 * k)
    function = ca.Function("f", [x, y], [ca.vertcat(*each, long)], ["x", "y"], ["all"])
    text = script_of(function)
    assert text.count("function(i,o,w)") > 2
    script = model_script(explored("excavator")[1].page).split("// The machine")[0]
    page = chromium.new_page()
    for at in ((0.7, 1.9), (2.3, 0.4)):
        found = page.evaluate(f"() => {{ {script}; return [...{text}.run([[{at[0]}], [{at[1]}]]).all]; }}")
        found = [math.inf if value is None else value for value in found]
        assert np.allclose(found, function(*at).full().ravel(), rtol=1e-13, atol=0)
    page.close()
    with pytest.raises(flexopt.ExportError, match="no equivalent in JavaScript"):
        script_of(ca.Function("g", [x], [ca.erf(x)]))


@pytest.mark.needs("node")
def test_operations_stand_inside_each_other() -> None:
    """What a comparison gives is a number that goes on: none of its signs meets that of the operation outside."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    single = {
        "less": x < y, "most": x <= y, "same": x == y, "other": x != y, "not": ca.logic_not(x),
        "both": ca.logic_and(x, y), "either": ca.logic_or(x, y), "minus": -y, "power": x**y, "sign": ca.sign(y),
        "chosen": ca.if_else(x, y, 0),
    }  # fmt: skip
    graphs = [graph for inner in single.values() for graph in (x + inner, x - inner, inner + inner * y, -inner)]
    graphs += [(x < y) + (y < x), (x < y) - (x <= y), (x < y) < (y <= x), (x == y) != (x < y)]
    texts = {
        f"f{k}": script_of(ca.Function("f", [x, y], [graph], ["x", "y"], ["all"])) for k, graph in enumerate(graphs)
    }
    points = [(0.0, 0.0), (0.0, 2.0), (2.0, 0.0), (2.0, 2.0), (3.0, -1.0)]
    model = model_script(explored("excavator")[1].page).split("// The machine")[0]
    asked = ",\n".join(f"({text})" for text in texts.values())
    text = f"{model}\nconst points = {json.dumps(points)};\n"
    text += f"const found = [{asked}].map((f) => points.map((at) => f.run(at.map((x) => [x])).all[0]));\n"
    text += "console.log(JSON.stringify(found));"
    done = subprocess.run(["node", "-"], input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    known = [[float(ca.Function("f", [x, y], [graph])(*at)) for at in points] for graph in graphs]
    np.testing.assert_allclose(json.loads(done.stdout), known, rtol=1e-15)


@pytest.mark.needs("chromium")
def test_linear_algebra_against_numpy(chromium: Browser) -> None:
    rng = np.random.default_rng(3)
    script = model_script(explored("excavator")[1].page)
    page = chromium.new_page()
    for n in (1, 2, 5, 14, 30):
        matrix = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-2, 1, (n, 1))
        flat = matrix.ravel(order="F").tolist()
        found = page.evaluate(f"""(a) => {{ {script}
          const A = Float64Array.from(a), n = {n};
          return {{ values: Linear.eigenvalues(A, n), e: [...Linear.exponential(A, n)], s: Linear.singular(A, n).sizes }};
        }}""", flat)  # fmt: skip
        apart = np.abs(np.array(found["values"]) @ [1, 1j] - np.linalg.eigvals(matrix)[:, None])
        assert apart[linear_sum_assignment(apart)].max() < 1e-11 * np.abs(matrix).sum()
        known = expm(matrix)
        assert np.allclose(np.reshape(found["e"], (n, n), order="F"), known, rtol=0, atol=1e-12 * np.abs(known).max())
        assert np.allclose(found["s"], np.linalg.svd(matrix)[1], rtol=1e-10)
    page.close()
