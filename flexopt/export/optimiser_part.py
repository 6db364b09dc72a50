"""The posture optimiser as a part of a bundle, which is not made of operations.

In: a `Context`, the bundle's prefix and precision. Out: an `OptimiserPart`: its header, source, tests, texts.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexopt.errors import ExportError, FlexoptError, FlexoptWarning
from flexopt.export.context import Context, unit_list
from flexopt.export.kernels import Real
from flexopt.export.naming import CWriter
from flexopt.export.optimiser import BUDGET_MAX, STARTS, OptimiserSources, build_optimiser
from flexopt.export.task_rows import orientation_texts, task_frame
from flexopt.foundation.arrays import Array
from flexopt.foundation.control import Control
from flexopt.foundation.documents import package_version
from flexopt.foundation.kept import by_machine
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.reach import arm_length, outer_reach, reach, sampled_ranges
from flexopt.robustness.measures import build_measures
from flexopt.selection import Selection, build_selection
from flexopt.selection.nlp.program import SOLVED, single
from flexopt.selection.proof.check import prove
from flexopt.selection.solve import solved
from flexopt.selection.starts import onto_target

# Share of the scale that V may lose against IPOPT's, and what still counts as on the target, m for each m of reach.
LOSS = {"double": 1e-8, "float": 1e-5}
ON_TARGET = {"double": 1e-9, "float": 1e-5}
VECTOR_COUNT, VECTOR_SEED = 4, 2
# IPOPT's starts for each vector: redundant arms have optima without end.
SELECT_STARTS = 8
DRAWS_MAX = 20
# The next best optimum is so much worse, and V / scale so curved at the best one, in scaled variables, that z must be
# the best one's; how close, m and rad, as V is flat at its top.
CLEARLY, CURVED, Z_TOLERANCE = 1e-3, 1e-2, 1e-3
# Placements that targets are drawn for; starts' distances from the optimum, m and rad. A curve of configurations is
# seen whole from anywhere; in a space of them the nearest optimum is sure to be the one that is meant only from nearby.
PLACED = {"m": 1.0, "rad": math.pi}
AWAY, NEARBY = 0.3, 0.01
# Where V / scale, along the target, rises faster than this in scaled variables, one step leads into another optimum's
# basin: starts of machines at work come to 1.1, of random trees near singular postures to 300.
STEEP = 2.0


@dataclass(frozen=True)
class ReferenceProblem:
    """A problem, a start, and the best of the local optima that IPOPT found and flexopt verified.

    Attributes:
        target, weights, start: what is asked.
        value, scale: V there, and what it is measured against.
        z: the optimum.
        unique: whether every other optimum found is clearly worse, and every other configuration nearby: where the
            machine turns about its target, V stays the same.
    """

    target: Array
    weights: Array
    start: Array
    value: float
    scale: float
    z: Array
    unique: bool


@dataclass(frozen=True)
class OptimiserPart:
    """The posture optimiser as a part.

    Attributes:
        at: what the bundle is built from.
        prefix, real: of the bundle.
        sources: the optimiser's texts.
    """

    at: Context
    prefix: str
    real: Real
    sources: OptimiserSources

    @property
    def functions(self) -> tuple[str, ...]:
        """Public names in C."""
        return tuple(f"{self.prefix}_optimiser_{name}" for name in ("default_problem", "default_options", "solve"))

    @cached_property
    def writer(self) -> CWriter:
        """What writes the bundle's texts."""
        return CWriter(self.prefix, self.real)

    @cached_property
    def library_files(self) -> dict[str, str]:
        """Path -> text of header and source."""
        source = self.writer.render(
            "optimiser_part.c", casadi=package_version("casadi"), body=self.sources.source.strip()
        )
        return {
            f"include/{self.prefix}_optimiser.h": self.sources.header,
            f"src/{self.prefix}_optimiser.c": source,
        }

    @cached_property
    def test_files(self) -> dict[str, str]:
        """Path -> text of the self-test and of the driver for `flexopt verify`."""
        vectors = self.vectors(VECTOR_COUNT, VECTOR_SEED)
        rows = [
            np.concatenate([v.target, v.weights, v.start, [v.value, v.scale, float(v.unique)], v.z]) for v in vectors
        ]
        selftest = self.writer.render(
            "optimiser_selftest.h",
            count=len(vectors),
            length=len(rows[0]),
            values=np.concatenate(rows).tolist(),
            loss=self.writer.number(LOSS[self.real]),
            on_target=self.writer.number(self.on_target),
            clearly=repr(CLEARLY),
            z_tolerance=self.writer.number(Z_TOLERANCE),
            compare_z=int(self.real == "double"),
            turns=[int(unit == "rad") for unit in self.at.choice_units],
            far_known=int(_far_row(self.at.machine) >= 0),
            far_row=_far_row(self.at.machine),
            nan_target=f"({self.prefix}_real)NAN",
            far=self.writer.number(1e5),
        )
        driver = self.writer.render("optimiser_driver.c")
        return {"test/optimiser_selftest.h": selftest, "test/optimiser_driver.c": driver}

    @property
    def on_target(self) -> float:
        """How far from the target still counts as on it, m."""
        return ON_TARGET[self.real] * max(1.0, outer_reach(self.at.plant)[1])

    def vectors(self, count: int, seed: int) -> tuple[ReferenceProblem, ...]:
        """Random problems and starts with their verified optima."""
        return _vectors(self.at.machine, self.at.control, self.margin_deg, count, seed)

    @property
    def margin_deg(self) -> float:
        """The distance from singular postures that the problems keep, degrees."""
        return float(f"{math.degrees(math.asin(self.at.singularity_margin)):.12g}")

    @cached_property
    def _example(self) -> str:
        """C statements that solve one problem and leave `found` (a status) and `answer`."""
        # From its start: from the optimiser's own ones some targets are not found.
        first = self.vectors(VECTOR_COUNT, VECTOR_SEED)[0]
        return self.writer.render("optimiser_example.c", target=first.target.tolist(), start=first.start.tolist())

    def example_call(self) -> str:
        """The same as a block of an example's main()."""
        return self.writer.render("optimiser_example_call.c", example=self._example)

    def readme(self) -> str:
        """A section of the README."""
        return self.writer.render(
            "optimiser_readme.md",
            budget=self.sources.budget,
            model_cost=self.sources.kernels.model_cost,
            control=self.at.control,
            variables=list(zip(self.at.choice, self.at.choice_units, strict=True)),
            rows=self.at.machine.task_rows,
            oriented=bool(orientation_texts(self.at.machine)),
            example=self._example,
            statuses=self.sources.status_texts,
        )

    def manifest(self) -> dict[str, Any]:
        """What manifest.json says of the part beside title and source."""
        plant, machine = self.at.plant, self.at.machine
        n_z, of_z = len(self.at.choice_units), unit_list(self.at.choice_units)

        def field(name: str, shape: Sequence[int], unit: str, text: str) -> dict[str, Any]:
            return {"name": name, "shape": list(shape), "unit": unit, "text": text}

        inputs = [
            field("target", [plant.n_task], "m", f"end-point ({', '.join(machine.task_rows)}), {task_frame(machine)}"),
            field("lower", [n_z], of_z, "lower bounds of z"),
            field("upper", [n_z], of_z, "upper bounds of z"),
            field("sine_squared_min", [], "", "squared sine of the margin from singular postures"),
            field("weights", [plant.n_passive], "", "alpha_i >= 0"),
            field("start", [n_z], of_z, "where the search begins; may be NULL"),
        ]
        if not self.at.baked:
            inputs.insert(5, field("parameters", [len(self.at.parameters.names)], "", "machine parameters"))
        outputs = [
            field("z", [n_z], of_z, "the configuration"),
            field("value", [], "", "V(z)"),
            field("scale", [], "", "what V is measured against"),
            field("target_error", [], "m", "largest |r - target|"),
            field("bound_violation", [], of_z, "how far outside its bounds a variable is"),
            field("margin_slack", [], "", "squared sine minus its minimum"),
            field("stationarity", [], "", "projected gradient of V/scale"),
            field("cost", [], "", "of the budget"),
            field("iterations", [], "", "climbing steps"),
            field("starts", [], "", "starts climbed from"),
        ]
        return {
            "header": f"include/{self.prefix}_optimiser.h",
            "functions": list(self.functions),
            "variables": list(self.at.choice),
            "units": list(self.at.choice_units),
            "inputs": inputs,
            "outputs": outputs,
            "statuses": self.sources.statuses,
            "workspace": self.sources.workspace_size,
            "budget": {"unit": "evaluations of V", "default": self.sources.budget, "most": BUDGET_MAX,
                       "derivatives_cost": self.sources.kernels.model_cost},
            "limits": {"starts": STARTS, "unbounded": COORDINATE_MAX, "loss": LOSS[self.real],
                       "target_error": self.on_target},
        }  # fmt: skip


def optimiser(at: Context, prefix: str, real: Real) -> OptimiserPart:
    """The posture optimiser of a bundle."""
    return OptimiserPart(at, prefix, real, build_optimiser(at, prefix, real))


@by_machine
def _vectors(
    machine: AnyMachine, control: Control, margin_deg: float, count: int, seed: int
) -> tuple[ReferenceProblem, ...]:
    rng = np.random.default_rng(seed)
    plant, made = build_plant(machine), list[ReferenceProblem]()
    reached = AWAY if plant.closed_form else NEARBY
    w, anywhere = build_measures(machine, control).w, np.random.default_rng(seed)
    drawn = [draw_configuration(plant, anywhere) for _ in range(8)]
    if not any(w.call([*at, plant.parameter_values])[1].full().any() for at in drawn):
        raise ExportError(
            "optimiser: no mode moves the end-point along the task, so that V is 0 everywhere and there is nothing to "
            "choose; leave the part out"
        )
    first = ""

    def rounded(values: Array) -> Array:
        # Few digits, the same in both precisions.
        return (values * 1024).round() / 1024

    for _ in range(DRAWS_MAX * count):
        target = rounded(draw_target(plant, rng))
        weights = rounded(np.eye(plant.n_passive)[0] if rng.random() < 0.5 else rng.uniform(0.1, 1, plant.n_passive))
        away = rng.uniform(-reached, reached, plant.n_base + plant.n_actuated)
        try:
            with warnings.catch_warnings():
                # Only V matters here, not what an optimum's other measures are worth.
                warnings.simplefilter("ignore", FlexoptWarning)
                found = solved(build_selection(
                    machine, target.tolist(), objective="V", control=control, weights=weights.tolist(),
                    singularity_margin_deg=margin_deg, starts=SELECT_STARTS, seed=int(rng.integers(1000)),
                    assume="limits",
                ), climbs=False)  # fmt: skip
        except FlexoptError as error:
            first = first or str(error)
            continue
        best = found.best
        if best.kinks:
            # The search in C knows slopes alone, and stops short of a kink by some 1e-5 of the scale.
            continue
        scale = float(f"{found.problem.objective_scale:.6g}")
        start = rounded(best.z + away)
        if not _found_again(found, start, scale):
            # So narrow a basin that IPOPT misses it from this start, too, and met it by chance from one of many.
            continue
        # V to nine digits of its scale, so that every computer exports the same.
        value = round(best.objective / scale, 9) * scale + 0.0
        z, unique = best.z, _determined(found, scale)
        made.append(ReferenceProblem(target, weights, start, value, scale, z.round(6), unique))
        if len(made) == count:
            return tuple(made)
    why = first and f"; of the first without one: {first}"
    raise ExportError(
        f"optimiser: only {len(made)} of {DRAWS_MAX * count} random targets have a verified optimum under a "
        f"singularity margin of {margin_deg:g} degrees, so it would be of no use; leave the part out{why}"
    )


def draw_target(plant: Plant, rng: np.random.Generator) -> Array:
    """A random target that some configuration reaches, (n_task,), m; its singularity margin aside."""
    if plant.closed_form:
        annulus = reach(plant)
        height = annulus.center[1] + annulus.outer * rng.uniform(-0.9, 0.9)
        return np.array([rng.uniform(-1, 1), height])
    (base, posture), p = draw_configuration(plant, rng), plant.parameter_values
    return plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()


def draw_configuration(plant: Plant, rng: np.random.Generator) -> tuple[Array, Array]:
    """A random placement and posture within the limits, (n_base,) and (n,), m or rad."""
    placed = np.array([PLACED[unit] for unit in plant.machine.base_units])
    ranges = sampled_ranges(plant.machine, arm_length(plant))
    return rng.uniform(-placed, placed), rng.uniform(ranges[:, 0], ranges[:, 1])


def _found_again(found: Selection, start: Array, scale: float) -> bool:
    """Whether V is not too steep at this start, and one solve from it alone reaches the best V."""
    problem = found.problem
    if not prove(problem, onto_target(problem, start[:, None])[0][:, 0]).stationarity <= STEEP:
        return False
    z, _, status = single(problem).solve(start)
    value = problem.branches(problem.objective, z)[0].min()
    return status in SOLVED and bool(value >= found.best.objective - CLEARLY * scale)


def _determined(found: Selection, scale: float) -> bool:
    """Whether z, and not V alone, can be told from the problem."""
    best, *others = found.candidates
    if any(best.objective - other.objective <= CLEARLY * scale for other in others):
        return False
    proof = prove(found.problem, best.z)
    return found.problem.redundancy <= len(proof.active) or proof.curvature < -CURVED


def _far_row(machine: AnyMachine) -> int:
    """Number of a row of the task that neither placement nor slides carry as far as one likes; −1 where none is."""
    slides = [limits for limits, unit in zip(machine.limits, machine.joint_units, strict=True) if unit == "m"]
    if not np.isfinite(slides).all():
        return -1
    rows = enumerate(machine.task_rows)
    return max((k for k, row in rows if row not in ("x", "y") or row not in machine.base_coordinates), default=-1)
