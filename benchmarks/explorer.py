"""The explorer in headless Chromium: numbers, frames, sizes, first picture: `python -m benchmarks.explorer`.

Deviations are the largest relative ones between the page and Python over random configurations, soils, payloads, gains
and dead times, w_i relative to |a_i||b_i|, and over configurations that real drags led to. Frames are the times between
two of them while the end-point is dragged on a circle, modes moving, the map live; `work` is what the page itself did
in one. First picture: from opening the file to the first frame drawn. Needs chromium and the extra `test`. A decay near
zero has no relative accuracy, in Python neither: its deviation stands beside `SampledLoop.rounding`, too. Meshes: the
largest number of triangles that a page has, in balls along the arm.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page

import flexopt
from benchmarks.timing import table
from flexopt.explorer.exploring import Explorer
from flexopt.explorer.meshes import TRIANGLES
from flexopt.model import AnyMachine
from flexopt.model.tables import Visual
from tests.browser import browser_of
from tests.explorer.browser import drag, opened, state
from tests.explorer.numbers import ASK, by_python, deviations, random_cases

MACHINES = ("excavator", "boom-stick-bucket", "slewing-excavator")
ROWS = (*((name, more) for more in ("", ", weight") for name in MACHINES), ("slewing-excavator", ", meshes"))
WATCH = """() => { window.times = []; explorer.log.frames.length = 0; explorer.log.maps.length = 0;
  const tick = (now) => { times.push(now); window.watching = requestAnimationFrame(tick); };
  tick(performance.now()); }"""
SEEN = """() => { cancelAnimationFrame(watching);
  const gaps = times.slice(2).map((t, k) => t - times[k + 1]);
  return { gaps, work: explorer.log.frames, maps: explorer.log.maps }; }"""


# Of a ball.
BALL = 320


def with_balls(machine: AnyMachine) -> AnyMachine:
    """As many triangles as a page has at most, on all bodies alike."""
    bodies, rng = machine.kinematic_tree.bodies, np.random.default_rng(0)
    balls = tuple(
        Visual(body=bodies[k % len(bodies)].name, shape="sphere", matrix=tuple(map(tuple, 0.15 * np.eye(3))),
               position=tuple(rng.uniform(-0.3, 0.3, 3)))
        for k in range(TRIANGLES // BALL)
    )  # fmt: skip
    return machine.model_copy(update={"visuals": balls})


def agreement(
    machine: AnyMachine, explorer: Explorer, browser: Browser, folder: Path, count: int, *, gravity: bool
) -> dict[str, float]:
    """The largest relative deviations, and that of w after drags."""
    cases = random_cases(machine, count)
    with opened(browser, explorer, folder) as page:
        python = by_python(machine, explorer, cases, gravity=gravity)
        found = deviations(page.evaluate(f"(cases) => ({ASK})(cases)", cases), python)
        page.locator("#motion").select_option("off")
        worst = 0.0
        for k in range(8):
            drag(page, ".handle.end", 20 * math.cos(k), 20 * math.sin(k))
            at = state(page)
            known = flexopt.evaluate(machine, at["posture"], base=at["base"], gravity=gravity).w
            sizes = np.array([mode["size"] for mode in at["modes"]])
            worst = max(worst, float(np.max(np.abs(np.array([m["w"] for m in at["modes"]]) - known) / sizes)))
    return found | {"w, dragged": worst}


def frames(page: Page, seconds: float) -> dict[str, np.ndarray]:
    """Times between frames and of the page's own work in one, ms, while the end-point goes round."""
    page.wait_for_function("explorer.map.shown !== null")
    box = page.locator(".handle.end").first.bounding_box()
    assert box is not None
    x, y = box["x"] + 18, box["y"] + 18
    page.mouse.move(x, y)
    page.mouse.down()
    for turn in ("warm", "measured"):
        if turn == "measured":
            page.evaluate(WATCH)
        for k in range(int(60 * seconds)):
            angle = 2 * math.pi * k / 60
            page.mouse.move(x + 40 * (math.cos(angle) - 1), y + 40 * math.sin(angle))
            page.wait_for_timeout(10)
    found = page.evaluate(SEEN)
    page.mouse.up()
    return {name: np.array(values) for name, values in found.items()}


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="random configurations of each machine")
    parser.add_argument("--only", default="", help="rows that have this in their name")
    parser.add_argument("--seconds", type=float, default=4.0, help="of dragging")
    options = parser.parse_args()
    numbers: list[tuple[str, ...]] = [
        ("machine", "omega", "zeta", "w", "|a||b|", "end-point", "w after drags", "decay", "decay / rounding")
    ]
    times: list[tuple[str, ...]] = [
        ("machine", "page kB", "first picture", "frames", "median", "95 %", "longest", "work", "95 %", "map", "maps")
    ]
    with browser_of() as browser, tempfile.TemporaryDirectory() as place:
        for name, more in ((name, more) for name, more in ROWS if options.only in name + more):
            machine, gravity = flexopt.load(name), more == ", weight"
            machine = with_balls(machine) if more == ", meshes" else machine
            explorer = flexopt.explore(machine, [1.0, -2.0] if name == "excavator" else None, gravity=gravity)
            found = agreement(machine, explorer, browser, Path(place), options.count, gravity=gravity)
            names = ("omega", "zeta", "w", "size", "r", "w, dragged", "decay, strictly", "decay / rounding")
            numbers.append((name + more, *(f"{found[key]:.1e}" for key in names)))
            first: list[float] = []
            for _ in range(5):
                with opened(browser, explorer, Path(place)) as page:
                    first.append(page.evaluate("explorer.log.first"))
            with opened(browser, explorer, Path(place)) as page:
                seen = frames(page, options.seconds)
            gaps, work, maps = seen["gaps"], seen["work"], seen["maps"]
            row = (np.median(gaps), np.quantile(gaps, 0.95), gaps.max(), np.median(work), np.quantile(work, 0.95))
            cost = f"{np.median(maps):.0f}" if maps.size else "not needed"
            times.append((name + more, f"{explorer.bytes / 1e3:.0f}", f"{np.median(first):.0f}", str(gaps.size),
                          *(f"{x:.1f}" for x in row), cost, str(maps.size)))  # fmt: skip
    print(table(f"Largest relative deviation from Python, {options.count} random configurations each", numbers))
    print(
        table(
            f"Dragging, map live, ms; map: all of its 10^4 cells (load {os.getloadavg()[0]:.1f})",
            times,
        )
    )


if __name__ == "__main__":
    main()
