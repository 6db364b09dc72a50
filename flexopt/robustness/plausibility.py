"""Whether a machine's numbers are plausible, its modes included, and the warning that says so where results are made.

In: a validated machine. Out: findings, those of `flexopt.model.plausibility` and of the modes: a first mode or a
damping that no machine on a base has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from flexopt.errors import ImplausibleMachine
from flexopt.foundation.arrays import Array, spread
from flexopt.foundation.kept import by_machine
from flexopt.foundation.warned import warn_user
from flexopt.model import AnyMachine
from flexopt.model.file_model import quoted
from flexopt.model.loop import Loop
from flexopt.model.plausibility import BASE_MASS, ImplausibleNumber, distant_ranges, implausible_numbers
from flexopt.plant import Plant, build_plant
from flexopt.plant.singularity import movable_rows, position_jacobian

FIRST_MODE = (0.1, 100.0)  # Hz
POSTURES = 4
# m per m, by which a placement leads out of the arm's plane; below, it is how a robot file rounds its angles.
OUT_OF_PLANE = 1e-3


@by_machine
def implausibilities(machine: AnyMachine) -> tuple[ImplausibleNumber, ...]:
    """Everything about the machine that is allowed but hardly meant."""
    found = implausible_numbers(machine)
    # Where springs, masses or lengths are off by their units, so are the modes, by the same slip.
    told = any("stiffness" in finding.field or finding.field in BASE_MASS for finding in found)
    modes = () if told else _of_modes(machine)
    return (*found, *modes, *_of_rows(machine), *_of_placement(machine), *distant_ranges(machine, machine.uncertainty))


def warn_implausible(machine: AnyMachine) -> None:
    """One `ImplausibleMachine` warning at the user's line, where there is anything to tell."""
    found = implausibilities(machine)
    if not found:
        return
    count = "a number is" if len(found) == 1 else f"{len(found)} numbers are"
    more = "" if len(found) == 1 else f"; and {len(found) - 1} more"
    sentence = f"machine {machine.name!r}: {count} not plausible (`flexopt check` tells all): {found[0]}{more}"
    warn_user(sentence, ImplausibleMachine)


def slow_rate(machine: AnyMachine, loop: Loop) -> Iterator[ImplausibleNumber]:
    """A sampling rate of `loop` that cannot see the first mode."""
    if loop.rate is None:
        return
    plant = build_plant(machine)
    with suppress(np.linalg.LinAlgError):
        first = min(float(modes_at(plant, posture)[0][0]) for posture in _postures(machine))
        if loop.rate < 2 * first:
            yield ImplausibleNumber(
                "loop.rate",
                f"{loop.rate:g} Hz",
                f"samples the first mode, {first:.3g} Hz, less than twice a period",
                f"probably the period in s: {1 / loop.rate:g} Hz",
            )


def _of_modes(machine: AnyMachine) -> tuple[ImplausibleNumber, ...]:
    plant = build_plant(machine)
    try:
        modes = [modes_at(plant, posture) for posture in _postures(machine)]
    except np.linalg.LinAlgError:
        return ()
    frequencies, shares = (np.array(part) for part in zip(*modes, strict=True))
    ratios, of_base = shares.sum(axis=1), shares[:, : plant.n_passive].sum(axis=1)
    found: list[ImplausibleNumber] = []
    first = frequencies[:, 0]
    if first.max() < FIRST_MODE[0] or first.min() > FIRST_MODE[1]:
        low, meant = first.max() < FIRST_MODE[0], "stiffnesses are probably in kN/m and kN m/rad"
        found.append(
            ImplausibleNumber(
                "first mode",
                f"{first[0]:.3g} Hz",
                f"a machine on its base swings at {FIRST_MODE[0]:g} to {FIRST_MODE[1]:g} Hz",
                meant if low else "stiffnesses are too large, or masses in tonnes",
            )
        )
    damped = ratios.min(axis=0)
    held = min(float(modes_at(plant, posture, held=True)[1].sum(axis=0).max()) for posture in _postures(machine))
    for mode in np.flatnonzero(damped > 1.0).tolist():
        value = float(damped[mode])
        meant = "dampers are probably too large by their unit (N s/m, N m s/rad), or the stiffness is in kN"
        if of_base[:, mode].min() < min(1.0, value / 2):
            most = shares[ratios[:, mode].argmin(), plant.n_passive :, mode]
            joint = machine.joints[int(most.argmax())]
            meant = f"it is the damper of the joint {joint}, probably too large by its unit, or one that stands for a "
            meant += "drive that holds: lock that joint, or give it no damping"
        elif held < 1.0:  # what is too little beside them is the base alone
            meant = "with the arm held it would: the base is probably too light, as an arm's foot without its vehicle"
        found.append(
            ImplausibleNumber(
                f"damping of mode {mode + 1}",
                f"{value:.3g} of critical",
                f"at {frequencies[0, mode]:.3g} Hz the machine would not swing at all",
                meant,
            )
        )
    return tuple(found)


def _of_rows(machine: AnyMachine) -> Iterator[ImplausibleNumber]:
    """Rows of the task that the joints never move together."""
    plant = build_plant(machine)
    rows, kept = machine.task_rows, movable_rows(plant)
    if kept != rows:
        yield ImplausibleNumber(
            "end_point.rows", quoted(rows), "in no posture do the joints move all of them",
            f"what they move is {quoted(kept)}" if kept else "they move none of them",
        )  # fmt: skip


def _of_placement(machine: AnyMachine) -> Iterator[ImplausibleNumber]:
    """A placement that leads out of the plane in which the task or the arm is."""
    placed, aside = machine.base_coordinates, [row for row in ("x", "y") if row not in machine.task_rows]
    if len(aside) != 1:
        return
    leaving = [name for name in placed if name in (*aside, "yaw")]
    row = f"{aside[0]} among end_point.rows"
    if leaving:
        kept = [name for name in placed if name not in leaving]
        yield ImplausibleNumber(
            "placement", quoted(placed), f"the end-point's {aside[0]} is no task row, and changes with "
            f"{' and '.join(leaving)}: what is chosen may lie beside the target",
            f"placement = {quoted(kept)}, or {row}" if kept else row,
        )  # fmt: skip
    elif placed:
        along, slope = placed[0], _aside(machine, placed[0], aside[0])
        if OUT_OF_PLANE < slope < 1 / OUT_OF_PLANE:
            yield ImplausibleNumber(
                "placement", quoted(placed), f"the arm moves in a plane {math.atan(slope):.3g} rad aside of {along}: "
                f"for each m of {along} the end-point's {aside[0]}, which is no task row, changes by {slope:.3g} m: "
                "what is chosen may lie beside the target",
                f"a mount whose arm moves along {along}, or a joint about z among actuated and {row}",
            )  # fmt: skip


def _aside(machine: AnyMachine, along: str, aside: str) -> float:
    """By how much the end-point's one coordinate changes with the other as the joints move it in one plane or line.

    0 where they keep to none, or to one of which neither is a part.
    """
    plant = build_plant(machine)
    base, p = np.zeros(plant.n_base), plant.parameter_values
    moved = [
        position_jacobian(plant, plant.rest(base, posture, p).full().ravel(), base) for posture in _postures(machine)
    ]
    directions, sizes, _ = np.linalg.svd(np.hstack(moved))
    i, j = "xyz".index(along), "xyz".index(aside)
    # Of a line its direction says it, of a plane its normal.
    if sizes[1] < OUT_OF_PLANE * sizes[0]:
        i, j, way = j, i, directions[:, 0]
    elif sizes[2] < OUT_OF_PLANE * sizes[1]:
        way = directions[:, 2]
    else:
        return 0.0
    if math.hypot(way[i], way[j]) < OUT_OF_PLANE:
        return 0.0
    return abs(float(way[i] / way[j])) if way[j] else math.inf


def modes_at(plant: Plant, posture: Array, *, held: bool = False) -> tuple[Array, Array]:
    """Frequencies, Hz, ascending, and damping ratios φᵀDφ / (2 ω), with the joints free as in `robustness.modes`.

    Of the ratios what each coordinate adds, (n_q, m).

    `held`: the arm held, as where somebody times how the machine swings. In numbers: `flexopt.check` would take a fifth
    longer if it built the measures' graphs.
    """
    m, p = plant.n_passive, plant.parameter_values
    base = np.zeros(plant.n_base)
    q = plant.rest(base, posture, p)
    mass: Array = plant.mass(q, base, p).full()
    stiffness: Array = plant.stiffness(p).full()
    damping: Array = plant.damping(p).full()
    with np.errstate(all="ignore"):
        follow = -np.linalg.solve(mass[m:, m:], mass[m:, :m]) * (not held)
        lower = np.linalg.cholesky(stiffness[:m, :m])
        compliance = np.linalg.solve(mass[:m, :m] + mass[:m, m:] @ follow, lower)
        symmetric = lower.T @ compliance
        values, z = np.linalg.eigh((symmetric + symmetric.T) / 2)
        omega = np.sqrt(np.maximum(values, 0.0))
        shapes = np.vstack([np.eye(m), follow]) @ (compliance @ z / omega)
        ratios = shapes * (damping @ shapes) / (2 * omega)
        return np.asarray(omega / (2 * math.pi), float), np.nan_to_num(ratios)


def _postures(machine: AnyMachine) -> list[Array]:
    """The middle of the joints' limits and some postures about it, always the same."""
    reach = {"rad": math.pi, "m": 1.0}
    units = [reach[unit] for unit in machine.joint_units]
    low = np.array([max(limits[0], -r) for limits, r in zip(machine.limits, units, strict=True)])
    high = np.array([min(limits[1], r) for limits, r in zip(machine.limits, units, strict=True)])
    low, high = np.minimum(low, high), np.maximum(low, high)
    return [(low + high) / 2, *(low + (high - low) * spread(POSTURES - 1, len(low)))]
