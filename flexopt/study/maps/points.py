"""Measures and margins at many postures at once, on the compiled batched path.

In: a machine, postures and placements as columns. Out: arrays with one column for each posture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexopt.algebra import symmetric_eigen
from flexopt.compiled import Economical
from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_structure
from flexopt.foundation.turns import available_cores
from flexopt.model import AnyMachine
from flexopt.plant.singularity import CONDITION_MAX, conditions, inverse_condition, screened
from flexopt.plant.statics import left_over
from flexopt.robustness import build_measures
from flexopt.robustness.margin import Margin, build_margin
from flexopt.robustness.measures import SOLVE_TOLERANCE, Measures
from flexopt.robustness.posture_margin import evaluate_margin

# Postures at a time, so that progress shows and memory stays small.
CHUNK = 4096
# What the batched Riccati equations may leave over, relative. Over the random machines of `benchmarks.margin_accuracy`
# ε_max is off by less than a hundred times that.
MARGIN_RESIDUAL = 1e-9


@dataclass(frozen=True)
class PointValues:
    """N postures; m modes. NaN where a posture is singular, or no equilibrium exists under gravity.

    Attributes:
        frequency_hz, w, scale: ω_i/2π, w_i and |a_i||b_i|, (m, N).
        trace: trace R_i, (m, N): in-phase where positive.
        least_diagonal: the smallest diagonal element of R_i, (m, N): strictly in-phase where not negative.
        rigid: λmin(R_0 + R_0ᵀ), (N,).
        condition: cond Jv, (N,), of singular postures too.
        epsilon_max: (N,), NaN where it was not asked for, no feedback of the end-point stabilises the plant, or it
            could not be computed.
    """

    frequency_hz: Vector
    w: Vector
    scale: Vector
    trace: Vector
    least_diagonal: Vector
    rigid: Vector
    condition: Vector
    epsilon_max: Vector


def evaluate_points(
    machine: AnyMachine,
    postures: Vector,
    *,
    bases: Vector | None = None,
    parameters: Vector | None = None,
    control: Control = "inverse",
    gain: float = 5e5,
    gravity: bool = False,
    epsilon_max: bool = True,
    threads: int | None = None,
    progress: Progress | None = None,
    expected: int | None = None,
) -> PointValues:
    """Everything about `postures` (n, N), rad or m, that a map or a curve shows, the base at `bases` (n_b, N) or at 0.

    The arguments are taken as they are; `map_workspace` checks them. `parameters` (n_par, N) take the place of the
    machine's own, not with ε_max. `expected` says how many points are to come in all, where these are not all.
    """
    threads = available_cores() if threads is None else threads
    count = postures.shape[1]
    ahead = count if expected is None else expected
    batches = expect_points(ahead, machine, control=control, gravity=gravity, epsilon_max=epsilon_max)
    placed = np.zeros((len(machine.base_coordinates), count)) if bases is None else bases
    parts: list[tuple[Vector, ...]] = []
    if progress is not None:
        progress(0, count)
    for start in range(0, max(count, 1), CHUNK):
        chunk = postures[:, start : start + CHUNK]
        base = placed[:, start : start + CHUNK]
        p = None if parameters is None else parameters[:, start : start + CHUNK]
        values = _measured(batches, base, chunk, p, threads)
        epsilon = np.full(chunk.shape[1], np.nan)
        sound = np.isfinite(values[-2])
        if epsilon_max and sound.any():
            epsilon[sound] = _margins(batches, base[:, sound], chunk[:, sound], gain, threads)
        parts.append((*values, epsilon))
        if progress is not None and count:
            progress(min(start + CHUNK, count), count)
    return PointValues(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))


@dataclass(frozen=True)
class Batches:
    """The Functions of one machine under one controller, for many points."""

    measures: Measures
    margin: Margin
    values: Economical
    margins: Economical | None


def expect_points(count: int, machine: AnyMachine, *, control: Control, gravity: bool, epsilon_max: bool) -> Batches:
    """The Functions that `evaluate_points` calls; those that are worth it for so many points begin to be compiled."""
    measures, margin = build_measures(machine, control, gravity), build_margin(machine, control, gravity)
    margins = _margins_of_many(margin) if epsilon_max else None
    batches = Batches(measures, margin, _measures_of_many(measures), margins)
    # The one that takes longer first.
    if batches.margins is not None:
        batches.margins.expect(count)
    batches.values.expect(count)
    return batches


@by_structure
def _margins_of_many(margin: Margin) -> Economical:
    return Economical(margin.values, margin.compacted.values)


@by_structure
def _measures_of_many(measures: Measures) -> Economical:
    """(base, posture, p) -> the measures as in `PointValues`, Jv, and what the static deflection left over.

    With a task of one row also the Jacobian of the position, with which the row is compared; see `plant.singularity`.
    """
    g, plant = measures.plant.graph, measures.plant
    inputs = [g.base, g.posture, g.p]
    v = dict(zip(measures.values.name_out(), measures.values.call(inputs), strict=True))
    diagonals = (v["a"] * v["b"]) @ v["same"].T
    rigid, _ = symmetric_eigen(v["rigid"] + v["rigid"].T)
    told = screened(plant)
    outputs = {
        "frequency_hz": ca.sqrt(v["omega_squared"]) / (2 * math.pi),
        "w": v["w"],
        "scale": ca.sqrt(ca.sum1(v["a"] ** 2) * ca.sum1(v["b"] ** 2)).T,
        "trace": ca.sum1(diagonals).T,
        "least_diagonal": ca.vertcat(*(ca.mmin(diagonals[:, i]) for i in range(plant.n_passive))),
        "rigid": rigid[0],
        "jv": told["jv"],
        "position": told["position"],
        "left_over": left_over(plant, v["q"], v["static_residual"]) if measures.gravity else ca.SX(0),
    }
    dense = [ca.densify(output) for output in outputs.values()]
    names = ["base", "posture", "p"], list(outputs)
    return Economical(ca.Function("map_measures", inputs, dense, *names, {"cse": True}))


def _measured(
    batches: Batches, bases: Vector, postures: Vector, parameters: Vector | None, threads: int
) -> tuple[Vector, ...]:
    """The fields of `PointValues` up to `condition`."""
    plant = batches.measures.plant
    p = np.array(plant.parameter_values).ravel() if parameters is None else parameters
    frequency, w, scale, trace, least, rigid, jv, position, left = batches.values(bases, postures, p, threads=threads)
    condition, largest = conditions(jv, plant.n_actuated)
    if plant.n_task == 1:
        of_position = conditions(position, plant.n_actuated)[1]
        with np.errstate(divide="ignore"):
            condition = np.maximum(largest, of_position) / largest
        largest = np.maximum(largest, of_position)
    inverted = inverse_condition(condition, largest, batches.measures.control)
    sound = (inverted <= CONDITION_MAX) & (left[0] <= SOLVE_TOLERANCE) & np.all(np.isfinite(w), axis=0)
    sound &= np.all(np.isfinite(frequency), axis=0)
    fields = (frequency, w, scale, trace, least, rigid[0])
    return (*(np.where(sound, field, np.nan) for field in fields), condition)


def _margins(batches: Batches, bases: Vector, postures: Vector, gain: float, threads: int) -> Vector:
    """ε_max (N,); one by one, in extended precision, where the batched equations are not solved well enough."""
    assert batches.margins is not None
    p = np.array(batches.margin.plant.parameter_values).ravel()
    epsilon, rest, residual = batches.margins(bases, postures, p, np.array([gain]), threads=threads)
    result = epsilon[0]
    for k in np.flatnonzero(~(np.fmax(rest[0], residual[0]) <= MARGIN_RESIDUAL)):
        value = evaluate_margin(batches.margin, bases[:, k], postures[:, k], gain, gradient=False).epsilon_max
        result[k] = np.nan if value is None else value
    return result
