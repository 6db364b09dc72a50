"""The page in Chromium: real drags, keys, touches and sliders, and what it shows of them against Python."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

import flexopt
from flexopt.explorer.exploring import Explorer
from flexopt.model import AnyMachine, shipped_names
from tests.browser import wide_tables
from tests.explorer.browser import POSTURE, drag, explored, opened, settled, state

pytestmark = pytest.mark.needs("chromium")


def end_point(machine: AnyMachine, at: dict[str, Any]) -> np.ndarray:
    """Where Python says the end-point of the page's configuration is."""
    plant = flexopt.build_plant(machine)
    p = plant.parameter_values
    return plant.end_point(plant.rest(at["base"], at["posture"], p), at["base"], p).full().ravel()


def same_as_python(machine: AnyMachine, explorer: Explorer, at: dict[str, Any]) -> None:
    """What the page shows of its configuration is what `flexopt.evaluate` says."""
    known = flexopt.evaluate(machine, at["posture"], base=at["base"])
    assert np.allclose([mode["w"] for mode in at["modes"]], known.w, rtol=0, atol=1e-9 * np.abs(known.w).max())
    assert np.allclose([mode["hz"] for mode in at["modes"]], known.frequencies_hz, rtol=1e-9)


def as_number(text: str) -> float:
    """As `12.3` or `1.23·10⁴`."""
    digits, _, power = text.replace("−", "-").partition("·10")
    return float(digits) * 10.0 ** int(power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")) or 0)


def pressed(page: Page, handle: str, *keys: str) -> dict[str, Any]:
    page.locator(handle).first.focus()
    for key in keys:
        page.keyboard.press(key)
    settled(page)
    return state(page)


@pytest.mark.long
@pytest.mark.parametrize("name", ["boom-stick-bucket", "slewing-excavator"])
def test_drags_and_keys_move_end_point_and_base(name: str, chromium: Browser, pages: Path) -> None:
    machine, explorer = explored(name)
    with opened(chromium, explorer, pages) as page:
        page.locator("#motion").select_option("off")
        before = state(page)
        drag(page, ".handle.end", -35, 25)
        after = state(page)
        moved = np.subtract(after["target"], before["target"])
        assert after["note"] == ""
        assert np.linalg.norm(moved) == pytest.approx(np.hypot(35, 25) / before["scale"], rel=1e-6)
        assert np.allclose(end_point(machine, after), after["target"], rtol=0, atol=1e-9)
        assert after["base"] == before["base"]
        same_as_python(machine, explorer, after)

        drag(page, ".handle.base", 12, 0)
        stood = state(page)
        assert np.linalg.norm(np.subtract(stood["base"], after["base"])) == pytest.approx(
            12 / before["scale"], rel=1e-6
        )
        assert np.allclose(end_point(machine, stood), after["target"], rtol=0, atol=1e-6)
        same_as_python(machine, explorer, stood)

        by_key = pressed(page, ".handle.end", "ArrowUp", "Shift+ArrowUp")
        risen = np.subtract(by_key["target"], stood["target"])
        assert risen[-1] > 0
        assert np.allclose(risen[:-1], 0, atol=1e-9)
        by_key_base = pressed(page, ".handle.base", "ArrowLeft")
        assert not np.allclose(by_key_base["base"], by_key["base"])
        assert np.allclose(end_point(machine, by_key_base), by_key["target"], rtol=0, atol=1e-6)


@pytest.mark.long
def test_limits_and_reach_are_kept(chromium: Browser, pages: Path) -> None:
    machine, explorer = explored("boom-stick-bucket")
    with opened(chromium, explorer, pages) as page:
        drag(page, ".handle.end", 900, -500, steps=12)
        at = state(page)
        assert "Out of reach" in at["note"]
        for angle, (low, high) in zip(at["posture"], machine.limits, strict=True):
            assert low <= angle <= high
        assert np.allclose(end_point(machine, at), at["target"], rtol=0, atol=1e-9)


@pytest.mark.long
def test_sliders_change_the_verdict_as_python_has_it(chromium: Browser, pages: Path) -> None:
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    with opened(chromium, flexopt.explore(machine, POSTURE, loop=loop), pages) as page:
        settled(page)
        known = flexopt.outcome(machine, POSTURE, loop=loop).decay
        first = state(page)
        assert first["decay"] == pytest.approx(known, rel=1e-8)
        assert first["word"] == ("settles" if known > 0 else "grows")
        slide = """([label, value]) => { const input = document.querySelector(`input[aria-label="${label}"]`);
          input.value = value; input.dispatchEvent(new Event("input")); }"""
        page.evaluate(slide, ["gain Kv", -1.5])
        page.evaluate(slide, ["dead time", 0.02])
        page.evaluate(slide, ["soil, all springs", 0.3])
        settled(page)
        later = state(page)
        data = machine.to_dict()
        data["base"]["stiffness"] = {k: 10**0.3 * v for k, v in data["base"]["stiffness"].items()}
        other = {"kp": 1e4, "kv": 1e3 * 10**-1.5, "dead_time": 0.02}
        known = flexopt.outcome(flexopt.machine_from_dict(data), POSTURE, loop=other).decay
        assert later["decay"] == pytest.approx(known, rel=1e-8)
        assert f"{'settles' if known > 0 else 'grows'} at" in later["text"]
        page.get_by_role("button", name="Reset").click()
        settled(page)
        assert state(page)["decay"] == pytest.approx(first["decay"], rel=1e-12)


@pytest.mark.long
def test_the_map_holds_what_python_computes(chromium: Browser, pages: Path) -> None:
    machine, explorer = explored("excavator")
    with opened(chromium, explorer, pages) as page:
        page.wait_for_function("explorer.map.shown !== null")
        found = page.evaluate("""() => { const { shown } = explorer.map; return { w: shown.w.map((each) => [...each]),
          x: [0, 50, 99].map((k) => explorer.map.value(0, k + 0.5, 100)) }; }""")
        w = np.array([[np.nan if v is None else v for v in each] for each in found["w"]]).reshape(3, 100, 100)
        middle = -np.pi + 2 * np.pi * (np.arange(100) + 0.5) / 100
        assert np.allclose(found["x"], middle[[0, 50, 99]], rtol=1e-14)
        rows, columns = np.array([5, 30, 70, 88]), np.array([2, 40, 61, 97])
        known = flexopt.evaluate_w(
            flexopt.build_measures(machine), bases=[np.zeros(4)], postures=[middle[columns], middle[rows]]
        ).w
        assert np.allclose(w[:, rows, columns], known, rtol=0, atol=1e-9 * np.abs(known).max())
        # A posture picked in the map is the machine's.
        box = page.locator("#map").bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + 62 + (box["width"] - 70) * 0.75, box["y"] + 6 + (box["height"] - 44) * 0.25)
        settled(page)
        assert np.allclose(state(page)["posture"], [np.pi / 2, np.pi / 2], atol=0.1)


@pytest.mark.long
@pytest.mark.parametrize("name", ["excavator", "slewing-excavator"])
def test_the_map_of_decay_is_that_of_the_loop(name: str, chromium: Browser, pages: Path) -> None:
    """Of the loop that the sliders ask for, from coarse to fine."""
    machine = flexopt.load(name)
    loop = {"kp": 1e4, "kv": 1e3} if name == "excavator" else {"kp": 3e6, "kv": 6e5, "drive": "torque", "rate": 200.0}
    explorer = flexopt.explore(machine, POSTURE if name == "excavator" else None, loop=loop)
    with opened(chromium, explorer, pages) as page:
        page.locator("#measure").select_option(label="decay of the loop")
        note = "document.getElementById('map-note').textContent"
        page.wait_for_function(
            f"explorer.map.shown?.gains != null && {note}.startsWith(`${{100 / explorer.map.shown.stride}} × `)"
        )
        # The middles of all parts that one posture stands for, however far the map is.
        found = page.evaluate("""() => { const { shown } = explorer.map, { x, y, stride } = shown, side = 100 / stride;
          return Array.from({ length: side * side }, (_, k) => {
            const [i, j] = [k % side, Math.floor(k / side)].map((n) => stride * n), q = Float64Array.from(explorer.posture);
            q[x] = explorer.map.value(x, i + stride / 2, 100);
            q[y] = explorer.map.value(y, j + stride / 2, 100);
            return [[...q], shown.decay[j * 100 + i]];
          });
        }""")
        known = [(posture, decay) for posture, decay in found if decay is not None]
        assert len(known) > len(found) / 2
        for posture, decay in known[:: len(known) // 12]:
            alone = flexopt.outcome(machine, posture, loop=loop)
            assert decay == pytest.approx(alone.decay, rel=1e-6, abs=1e-9 * alone.settings.rate)
        # Another gain: from the coarse map again.
        page.evaluate("""() => { const input = document.querySelector('input[aria-label="gain Kp"]');
          input.value = 0.5; input.dispatchEvent(new Event("input")); }""")
        page.wait_for_function(
            "Math.abs(explorer.map.shown.gains?.kp[0] / explorer.data.loop.numbers.kp[0] - 10 ** 0.5) < 1e-9"
        )
        page.locator("#measure").select_option(label="w1")
        page.wait_for_function("explorer.map.shown.gains === null")


@pytest.mark.long
def test_the_picture_in_space_turns(chromium: Browser, pages: Path) -> None:
    """By what is dragged beside the handles and by keys, about the ground point; the machine stays as it is."""
    _, explorer = explored("truck-crane")
    with opened(chromium, explorer, pages) as page:
        page.locator("#motion").select_option("off")
        axes = "() => ({ axes: explorer.views[0].axes, pivot: explorer.views[0].at(explorer.shape.points[0]) })"
        before, at = page.evaluate(axes), state(page)
        canvas = page.locator("canvas.turning")
        box = canvas.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 20, box["y"] + box["height"] - 20)
        page.mouse.down()
        page.mouse.move(box["x"] + 120, box["y"] + box["height"] + 10, steps=4)
        page.mouse.up()
        settled(page)
        dragged = page.evaluate(axes)
        canvas.focus()
        page.keyboard.press("ArrowUp")
        settled(page)
        after = page.evaluate(axes)
        for each in (dragged, after):
            turned = np.array(each["axes"])
            assert np.allclose(turned @ turned.T, np.eye(2), atol=1e-12)
            assert np.allclose(each["pivot"], before["pivot"], atol=1e-6)
        assert not np.allclose(dragged["axes"], before["axes"], atol=0.1)
        assert after["axes"][1][2] < dragged["axes"][1][2]
        assert state(page)["posture"] == at["posture"]
        # A drag in the turned picture moves the end-point in its plane.
        drag(page, ".handle.end", 15, -20)
        moved = np.subtract(state(page)["target"], at["target"])
        assert np.allclose(np.array(after["axes"]) @ moved * at["scale"], [15, 20], atol=1e-6)


@pytest.mark.long
def test_a_problem_shows_its_recommendation(chromium: Browser, pages: Path) -> None:
    problem = flexopt.load_problem("article")
    explorer = flexopt.explore(problem)
    best = flexopt.solve_problem(problem).best.evaluation
    with opened(chromium, explorer, pages) as page:
        page.get_by_role("button", name="recommended").click()
        settled(page)
        at = state(page)
    assert np.allclose(at["posture"], best.posture, atol=1e-9)
    assert np.allclose(at["base"], best.base, atol=1e-9)
    assert np.allclose([mode["w"] for mode in at["modes"]], best.w, rtol=0, atol=1e-9 * np.abs(best.w).max() + 1e-12)


@pytest.mark.long
@pytest.mark.parametrize("width", [400, 1280])
def test_it_fits_light_and_dark_and_takes_touches(width: int, chromium: Browser, pages: Path) -> None:
    _, explorer = explored("excavator")
    context = {"viewport": {"width": width, "height": 900}, "color_scheme": "dark", "has_touch": True}
    with opened(chromium, explorer, pages, **context) as page:
        assert page.evaluate("document.documentElement.dataset.theme") == "dark"
        page.locator("#theme").tap()
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        wide_tables(page, width)
        # A finger that drags the end-point does not scroll the page.
        session, box = page.context.new_cdp_session(page), page.locator(".handle.end").bounding_box()
        assert box is not None
        x, y, before = box["x"] + 18, box["y"] + 18, state(page)
        for kind, points in (
            ("touchStart", [{"x": x, "y": y}]), ("touchMove", [{"x": x + 10, "y": y + 10}]),
            ("touchMove", [{"x": x + 20, "y": y + 20}]), ("touchEnd", []),
        ):  # fmt: skip
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        settled(page)
        moved = np.subtract(state(page)["target"], before["target"]) * before["scale"]
        assert np.allclose(moved, [20, -20], atol=1e-6)


@pytest.mark.long(
    "400-mobile-manipulator", "400-slewing-excavator", "1280-mobile-manipulator", "1280-slewing-excavator"
)
@pytest.mark.parametrize("name", ["excavator", "mobile-manipulator", "slewing-excavator"])
@pytest.mark.parametrize("width", [400, 1280])
def test_arrows_of_all_modes_are_in_the_picture(name: str, width: int, chromium: Browser, pages: Path) -> None:
    _, explorer = explored(name)
    with opened(chromium, explorer, pages, viewport={"width": width, "height": 900}) as page:
        beyond = """explorer.views.map((view) => Math.max(...explorer.arrows(view).map(({ vector, length }) => {
          const [x, y] = view.at(explorer.shape.points.at(-1)), size = length / Math.hypot(...vector);
          const [u, v] = view.flat(vector).map((along) => size * along);
          return Math.max(-(x + u), x + u - view.width, -(y - v), y - v - view.height);
        })))"""
        assert max(page.evaluate(beyond)) < 0


# Of each view: how far what is drawn goes beyond its edge, px, and how far handles do; negative inside.
DRAWN = """explorer.views.map((view) => {
  const beyond = ([x, y], r = 0) => Math.max(r - x, x + r - view.width, r - y, y + r - view.height);
  return Math.max(...[explorer.shape, ...explorer.ghosts.map((ghost) => ghost.shape)].flatMap((shape) => [
    ...[...shape.points, ...shape.support].map((point) => beyond(view.at(point))),
    ...shape.capsules.flatMap(({ ends, radius }) => ends.map((end) => beyond(view.at(end), view.scale * radius))),
  ]));
})"""
HANDLES = """explorer.views.flatMap((view) => [...view.box.querySelectorAll(".handle")].map((handle) => {
  const [box, own] = [view.canvas, handle].map((each) => each.getBoundingClientRect());
  return Math.max(box.left - own.left, own.right - box.right, box.top - own.top, own.bottom - box.bottom);
}))"""


@pytest.mark.long(
    "400-mobile-manipulator",
    "400-truck-crane",
    "1280-mobile-manipulator",
    "1280-slewing-excavator",
    "1280-truck-crane",
    "400-boom-stick-bucket",
    "400-slewing-excavator",
    "1280-boom-stick-bucket",
    "1280-excavator",
)
@pytest.mark.parametrize("name", shipped_names("models"))
@pytest.mark.parametrize("width", [400, 1280])
def test_all_that_is_drawn_is_in_the_first_view(name: str, width: int, chromium: Browser, pages: Path) -> None:
    _, explorer = explored(name)
    with opened(chromium, explorer, pages, viewport={"width": width, "height": 900}) as page:
        settled(page)
        assert max(page.evaluate(DRAWN)) < 0
        assert max(page.evaluate(HANDLES)) < 0.5


@pytest.mark.long
def test_wherever_it_stands_it_is_in_the_first_view(chromium: Browser, pages: Path) -> None:
    """Nearer to who looks than the origin, too: ground is lower in the picture there."""
    explorer = flexopt.explore(flexopt.load("mobile-manipulator"), base=[4.0, -4.0, 0.0])
    with opened(chromium, explorer, pages) as page:
        assert max(page.evaluate(DRAWN)) < 0
        assert max(page.evaluate(HANDLES)) < 0.5


@pytest.mark.long
def test_a_handle_let_go_of_is_in_the_picture(chromium: Browser, pages: Path) -> None:
    """During the drag the picture stays as it is."""
    _, explorer = explored("slewing-excavator")
    with opened(chromium, explorer, pages) as page:
        page.locator("#motion").select_option("off")
        above, beyond = page.locator(".view").nth(1), list[float]()
        for handle in [".handle.end"] * 2 + [".handle.base"] * 4:
            box = above.locator(handle).bounding_box()
            assert box is not None
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x, y + 60, steps=6)
            settled(page)
            beyond.append(max(page.evaluate(HANDLES)))
            page.mouse.up()
            settled(page)
            assert max(page.evaluate(HANDLES)) < 0.5
        assert max(beyond) > 0.5


@pytest.mark.long
@pytest.mark.parametrize("name", ["excavator", "truck-crane"])
def test_on_paper_it_is_light_and_has_nothing_to_press(name: str, chromium: Browser, pages: Path) -> None:
    """What was dark on the screen is so again afterwards; pictures have the shape that they were drawn in."""
    _, explorer = explored(name)
    ground = "getComputedStyle(document.documentElement).getPropertyValue('--page')"
    with opened(chromium, explorer, pages, color_scheme="dark") as page:
        dark, text = page.evaluate(f"[{ground}, explorer.theme.text]")
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 718, "height": 1000})
        page.evaluate("dispatchEvent(new Event('beforeprint'))")
        light, printed = page.evaluate(f"[{ground}, explorer.theme.text]")
        assert light != dark
        assert printed != text
        assert page.locator(":is(button:not(#modes button), input, .handle, #motion):visible").count() == 0
        assert page.locator("output:visible").count() > 3
        fits = "[...document.querySelectorAll('.view canvas')].map((each) => getComputedStyle(each).objectFit)"
        assert set(page.evaluate(fits)) == {"contain"}
        page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert page.evaluate(f"[{ground}, explorer.theme.text]") == [dark, text]


@pytest.mark.long
def test_a_notebook_shows_it(chromium: Browser, pages: Path) -> None:
    _, explorer = explored("excavator")
    cell = pages / "cell.html"
    cell.write_text(f"<!DOCTYPE html><meta charset='utf-8'>{explorer._repr_html_()}", encoding="utf-8")
    page = chromium.new_page()
    page.goto(cell.as_uri())
    frame = page.frame_locator("iframe")
    frame.locator("#verdict .word").wait_for()
    assert "at" in frame.locator("#verdict").inner_text()
    page.close()
    assert html.unescape(explorer._repr_html_().split('srcdoc="')[1].split('" style=')[0]) == explorer.page


@pytest.mark.long
def test_a_gain_is_read_in_one_format(chromium: Browser, pages: Path) -> None:
    """Beside its slider and in the sentence on the loop."""
    explorer = flexopt.explore(flexopt.load("excavator"), POSTURE, loop={"kp": 1e4, "kv": 2e6})
    with opened(chromium, explorer, pages) as page:
        sentence = page.locator("#loop").inner_text()
        assert "Kp 10000 N m, Kv 2·10⁶ N m s" in sentence
        sliders = page.locator("#sliders").inner_text()
        assert "10000 N m" in sliders
        assert "2·10⁶ N m s" in sliders


def test_a_machine_of_one_joint_has_no_map(chromium: Browser, pages: Path) -> None:
    """A map is over two."""
    spring = {
        "name": "base.pitch",
        "kind": "hinge",
        "axis": [0, 1, 0],
        "passive": True,
        "stiffness": 7e3,
        "damping": 14,
    }
    turns = {"name": "boom", "kind": "hinge", "axis": [0, 1, 0]}
    bodies = [
        {"name": "cart", "parent": None, "joint": spring, "mass": 100.0, "com": [0, 0, 0.2], "inertia": [9, 9, 9, 0, 0, 0]},
        {"name": "arm", "parent": "cart", "joint": turns, "mass": 5.0, "com": [0.4, 0, 0], "inertia": [1, 1, 1, 0, 0, 0]},
    ]  # fmt: skip
    end = {"body": "arm", "position": [0.8, 0.0, 0.0], "rows": ["x"]}
    machine = flexopt.tree_from_dict({"name": "one", "bodies": bodies, "end_point": end})
    with opened(chromium, flexopt.explore(machine, [-1.0], loop={"kp": 1e2, "kv": 1e1}), pages) as page:
        assert state(page)["modes"]
        text = page.locator("#numbers").inner_text()
        assert "Configuration" in text
        assert not any(words in text for words in ("Map", "colour", "robust"))


@pytest.mark.parametrize(
    ("loop", "posture", "doubted"),
    [
        ({"drive": "velocity", "kp": 0.3, "kv": 1e-3, "servo_gain": 2e6}, POSTURE, 3),
        ({"drive": "velocity", "kp": 0.3, "kv": 1e-3, "servo_gain": 2e2}, POSTURE, 0),
        ({"kp": 1e4, "kv": 1e3}, POSTURE, 1),
        ({"kp": 70386.7179, "kv": 3158.629}, [0.3701, -0.3191], 1),
        ({"kp": 818583.253, "kv": 2288.127}, [-0.2891049, -0.8456419], 2),
        ({"kp": 192491.853, "kv": 84588.883}, [-0.0638161, -1.0109142], 3),
    ],
)
def test_a_word_of_first_order_is_doubted_where_the_loop_does_otherwise(
    loop: dict[str, Any], posture: list[float], doubted: int, chromium: Browser, pages: Path
) -> None:
    """As `flexopt.outcome` doubts it, whatever serves the joints, and where the exact decay has another sign."""
    machine = flexopt.load("excavator")
    found = flexopt.outcome(machine, posture, loop=loop)
    with opened(chromium, flexopt.explore(machine, posture, loop=loop), pages) as page:
        told = page.locator("#modes tbody tr").all_inner_texts()
    doubts = np.array(["for this first order" in text for text in told])
    grows = np.array(["▲ grows" in text for text in told])
    assert doubts.tolist() == (found.first_order_fails | (grows != (found.mode_decay < 0))).tolist()
    assert doubts.sum() == doubted
    for text, decay in zip(told, found.mode_decay, strict=True):
        for word, rate in re.findall(r"in the sampled loop it (\w+) at (\S+) /s", text):
            assert word == ("decays" if decay > 0 else "grows")
            # Three digits are shown.
            assert as_number(rate) == pytest.approx(abs(decay), rel=5e-3)


@pytest.mark.long
@pytest.mark.parametrize(("name", "gain"), [("excavator", "Kv"), ("boom-stick-bucket", "g Kv")])
def test_a_mode_grows_from_a_gain_on_whatever_serves_the_joints(
    name: str, gain: str, chromium: Browser, pages: Path
) -> None:
    posture = POSTURE if name == "excavator" else [-1.0, -1.5, -1.0]
    with opened(chromium, flexopt.explore(flexopt.load(name), posture), pages) as page:
        told = page.locator("#modes tbody").inner_text()
        known = flexopt.outcome(flexopt.load(name), posture).allowance_isotropic
        bounds = [
            (as_number(bound), as_number(now))
            for bound, now in re.findall(rf"grows if {gain} > κiso = (\S+); it is (\S+)", told)
        ]
        assert [bound for bound, _ in bounds] == pytest.approx(known[np.isfinite(known)], rel=1e-3)
        # Of the gain that the page has now: a mode grows beyond its bound only.
        assert told.count("▲ grows") == sum(now > bound for bound, now in bounds)
        assert told.count("△ excited") == sum(now <= bound for bound, now in bounds) > 0
        assert told.count("▼ settles") == len(known) - len(bounds)
        page.evaluate("explorer.factors.kv = 1e6; explorer.touched();")
        settled(page)
        beyond = len(bounds) if name == "excavator" else 0  # The other's Kv is 0.
        assert page.locator("#modes tbody").inner_text().count("▲ grows") == beyond
        assert ("g the servo gain" in page.locator("#numbers").inner_text()) == (gain != "Kv")
