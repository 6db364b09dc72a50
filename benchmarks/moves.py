"""Verdicts against ensembles: `python -m benchmarks.moves [--problems N] [--members N]`.

The shipped problems and random ones (a target that the machine reaches from where it stands, the loop
that follows from the machine, springs and dampers known to a factor of two, dead times of up to 20 ms). Each verdict,
from its usual few points of what is uncertain, is judged on many others: how many of them decay a tenth faster where it
says to move, and what nonlinear runs of all of them show there.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

import flexopt
from flexopt.errors import FlexoptError
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.study.verdicts.decision import MOST, faster
from flexopt.study.verdicts.place_loops import PlaceLoops
from flexopt.study.verdicts.result import STAY, PlaceVerdict

SHIPPED = ("pipe-laying", "stations", "trench", "article", "article-transpose")
MACHINES = ("excavator", "boom-stick-bucket", "slewing-excavator", "truck-crane", "mobile-manipulator")
GROUND = {"stiffness": (0.5, 2.0), "damping": (0.5, 2.0), "dead_time": (0.0, 0.02)}
SEED, DURATION = 7, 20.0


def problems(count: int) -> Iterator[tuple[str, Any]]:
    """Names, and what `flexopt.verdict` takes."""
    for name in SHIPPED:
        problem = flexopt.load_problem(name)
        yield name, lambda problem=problem: flexopt.verdict(problem, ranges=GROUND)
    for number in range(count):
        name = MACHINES[number % len(MACHINES)]
        machine, rng = flexopt.load(name), np.random.default_rng(number)
        plant = flexopt.build_plant(machine)
        low, high = np.clip(np.array(machine.limits), -2.0, 2.0).T
        posture = low + (high - low) * rng.uniform(0.2, 0.8, len(low))
        base, p = np.zeros(len(machine.base_coordinates)), plant.parameter_values
        target = plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
        given = {"objective": "V", "weights": [1.0] * plant.n_passive, "base": base, "posture": posture}
        yield (
            f"{number}: {name}",
            lambda machine=machine, target=target, given=given: flexopt.verdict(
                machine, target, loop="default", ranges=GROUND, **given
            ),
        )


def judged(verdict: flexopt.Verdict, members: int) -> str:
    """What other members say of a verdict; a sentence that begins with "contradicted" where they do."""
    first = verdict.problems[0]
    box = UncertaintyBox(first.machine, verdict.uncertainty, verdict.settings.dead_time)
    points = box.members(members, SEED)
    places = {place.name: place for place in verdict.places}

    def loops(place: PlaceVerdict) -> PlaceLoops:
        return PlaceLoops.at(verdict.settings, place.stands, box, gravity=first.gravity)

    told = places.get(verdict.place)
    if verdict.word == "cannot tell" or told is None:
        return ""
    gains = {name: np.array(values) for name, values in verdict.gains.items()}
    there = loops(told).with_settings(replace(verdict.settings, **gains))
    each = there.decays(points)
    decays, runs = each.min(axis=0), there.runs(points, each, DURATION)
    sentence = f"{100 * np.mean(decays > 0):.1f} % stable, {100 * runs.confirming:.1f} % confirmed by runs"
    wrong = bool(np.any(decays <= 0)) or runs.growing > 1 - MOST
    if verdict.word == "move" and STAY in places:
        share = float(np.mean(faster(decays, loops(places[STAY]).decays(points).min(axis=0))))
        sentence = f"better on {100 * share:.1f} %, {sentence}"
        wrong = wrong or share < MOST
    return f"contradicted: {sentence}" if wrong else sentence


def main() -> None:
    """A line for each problem, and how many verdicts were contradicted."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else "")
    parser.add_argument("--problems", type=int, default=20)
    parser.add_argument("--members", type=int, default=1000)
    options = parser.parse_args()
    words, wrong = Counter[str](), 0
    for name, ask in problems(options.problems):
        begun = time.perf_counter()
        try:
            verdict = ask()
        except FlexoptError as error:
            print(f"{name:24s} {type(error).__name__}: {str(error)[:160]}", flush=True)
            words["refused"] += 1
            continue
        middle = time.perf_counter()
        sentence = judged(verdict, options.members)
        words[verdict.word] += 1
        wrong += sentence.startswith("contradicted")
        times = f"{middle - begun:5.1f} s and {time.perf_counter() - middle:5.1f} s"
        print(f"{name:24s} {verdict.word:12s} {times}  {sentence}", flush=True)
    print(f"{options.members} members: {dict(words)}; contradicted: {wrong} (bar 0)")


if __name__ == "__main__":
    main()
