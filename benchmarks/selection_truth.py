"""Selections by mixes of w_i and ε_max and by objectives in order, beside a scan that shares nothing with the solvers.

Run: python -m benchmarks.selection_truth [--machines N] [--seeds K …] [--targets N] [--points N] [--workers N]

For each target a scan of N configurations: placements and leading joints are drawn at random, the last two segments
reach the target in closed form (here, in NumPy), the w_i come from `flexopt.evaluate_w` and ε_max from a doubling in
NumPy; what the scan says is best is confirmed by SciPy's Riccati solver, and in 420 bits where that decides: on stiff
machines SciPy's ε_max rounds to some 1e-8. No derivative, no solver enters. Printed is by how much the scan is better
than the selection, as a share of the objective's scale; negative: the selection is better. For objectives in order that
is the worst over them, each among the points that keep those before.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_are

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError
from flexopt.model import Machine
from flexopt.model.choices import SINGULARITY_MARGIN_DEG
from flexopt.robustness.margin import build_margin
from flexopt.robustness.measures import build_measures
from tests.oracles.high_precision import MarginOracle
from tests.oracles.machines import arm_at_rest, random_machine, regular_posture, segment_lengths

GAIN = 5e5
CONTROLS = ("inverse", "transpose")
# From which gap on ε_max is computed in many digits: far below what is asked, above what doubles tell of soft machines.
DECIDES = 1e-8
EXCAVATOR = ((0.0, 1.6), (0.4, 2.4), (-0.3, -0.6))
# Shares of w_1, w_2, … (the rest as the last) and of ε_max, in units of the typical |a_i||b_i|; and orders.
MIXES = ((1.0, 0.3, 1e-2), (1.0, 0.0, 1.0), (0.2, 1.0, 1e-1), (1.0, 1.0, 1e-3))
ORDERS = ("w1,epsilon_max", "epsilon_max,w1")
Case = tuple[str, str, tuple[float, ...] | None]


@dataclass(frozen=True)
class Scanned:
    """Configurations (n_z, N) that reach a target inside limits and margin, with w (m, N) and ε_max (N,)."""

    z: np.ndarray
    w: np.ndarray
    epsilon: np.ndarray


def configurations(machine: Machine, target: np.ndarray, count: int, seed: int) -> np.ndarray:
    """`count` configurations z at random, the end-point on the target; the geometry is NumPy's own."""
    rng = np.random.default_rng(seed)
    n, lengths = len(machine.joints), segment_lengths(machine)
    sine = math.sin(math.radians(SINGULARITY_MARGIN_DEG))
    plant = build_measures(machine).plant
    height = arm_at_rest(machine, np.zeros(n))[0][0]
    reach = math.sqrt(max(lengths.sum() ** 2 - (target[1] - height[1]) ** 2, 0.0))
    found: list[np.ndarray] = []
    total = 0
    for _ in range(200):
        x = target[0] - height[0] + rng.uniform(-reach, reach, 4 * count)
        joints = rng.uniform(-math.pi, math.pi, (n, x.size))
        z = np.vstack([x, closed_arm(machine, target, x, joints, rng.integers(0, 2, x.size) * 2 - 1)])
        z = z[:, np.isfinite(z).all(axis=0)]
        limits = np.array(machine.limits)
        z[1:] = np.where(np.isfinite(limits[:, :1]), z[1:], (z[1:] + math.pi) % (2 * math.pi) - math.pi)
        inside = np.all((z[1:] >= limits[:, :1]) & (z[1:] <= limits[:, 1:]), axis=0)
        z = z[:, inside]
        z = z[:, plant.singularity_sine_squared(z[:1], z[1:], plant.parameter_values).full().ravel() >= sine**2]
        found.append(z)
        total += z.shape[1]
        if total >= count:
            break
    return np.concatenate(found, axis=1)[:, :count]


def closed_arm(
    machine: Machine, target: np.ndarray, x: np.ndarray, joints: np.ndarray, elbow: np.ndarray
) -> np.ndarray:
    """Joints with the last two such that the end-point is on the target; NaN where it is out of their reach.

    Rigid offsets between joints, those of passive links at rest among them, are seen by placing the arm twice.
    """
    n = joints.shape[0]
    # Segment k as a complex number in the frame of its joint, all joints at zero.
    at_zero, tip = arm_at_rest(machine, np.zeros(n))
    corners = np.vstack([at_zero, tip])
    segments = np.diff(corners[:, 0] + 1j * corners[:, 1])
    place = x + corners[0, 0] + 1j * corners[0, 1]
    turn = np.zeros(x.size)
    for k in range(n - 2):
        turn = turn + joints[k]
        place = place + segments[k] * np.exp(1j * turn)
    left = (target[0] + 1j * target[1] - place) * np.exp(-1j * turn)
    first, second = segments[n - 2], segments[n - 1]
    # left = e^{iα}(first + e^{iβ} second).
    cosine = (np.abs(left) ** 2 - abs(first) ** 2 - abs(second) ** 2) / (2 * abs(first) * abs(second))
    with np.errstate(invalid="ignore"):
        between = elbow * np.arccos(cosine)
        beta = between - np.angle(second / first)
        alpha = np.angle(left / (first + np.exp(1j * beta) * second))
    out = joints.copy()
    out[n - 2], out[n - 1] = alpha, (beta + math.pi) % (2 * math.pi) - math.pi
    return np.where(np.isfinite(between), out, np.nan)


def scanned(machine: Machine, target: np.ndarray, control: Any, count: int, seed: int) -> Scanned:
    """The scan of one target."""
    z = configurations(machine, target, count, seed)
    measures = build_measures(machine, control)
    w = flexopt.evaluate_w(measures, z[:1], z[1:]).w
    epsilon = np.concatenate([doubled_margins(machine, control, part) for part in np.array_split(z, 10, axis=1)])
    fine = np.isfinite(epsilon) & np.isfinite(w).all(axis=0)
    return Scanned(z[:, fine], w[:, fine], epsilon[fine])


def doubled_margins(machine: Machine, control: Any, z: np.ndarray, shift: float = 2.0) -> np.ndarray:
    """ε_max (N,) by structure-preserving doubling in NumPy: both Riccati equations at once."""
    a, b, c = state_spaces(machine, control, z)
    g, h = b @ b.transpose(0, 2, 1), c.transpose(0, 2, 1) @ c
    unit = np.eye(a.shape[1])
    moved = a - shift * unit
    back = np.linalg.inv(moved)
    other = np.linalg.inv(moved.transpose(0, 2, 1) + h @ back @ g)
    e = unit + 2 * shift * other.transpose(0, 2, 1)
    g, h = 2 * shift * back @ g @ other, 2 * shift * other @ h @ back
    for _ in range(40):
        inner = np.linalg.inv(unit + g @ h)
        g, h, e = g + e @ inner @ g @ e.transpose(0, 2, 1), h + e.transpose(0, 2, 1) @ h @ inner @ e, e @ inner @ e
        if np.abs(e).max() < 1e-15:
            break
    product = g @ h
    fine = np.isfinite(product).all(axis=(1, 2))
    margins = np.full(z.shape[1], np.nan)
    margins[fine] = 1 / np.sqrt(1 + np.linalg.eigvals(product[fine]).real.max(axis=1))
    return margins


def state_spaces(machine: Machine, control: Any, z: np.ndarray) -> list[np.ndarray]:
    """A, B, C of configurations (n_z, N), scaled, (N, …) each."""
    margin = build_margin(machine, control)
    at = [z[:1], z[1:], margin.plant.parameter_values, np.full((1, z.shape[1]), GAIN)]
    stacked = [x.full() for x in margin.scaled_plant.call([*at, *margin.hold.call(at)])]
    return [x.reshape(x.shape[0], z.shape[1], -1).transpose(1, 0, 2) for x in stacked]


def scipy_margin(machine: Machine, control: Any, z: np.ndarray) -> float:
    """ε_max of one configuration by SciPy, in the scaled coordinates."""
    a, b, c = (x[0] for x in state_spaces(machine, control, z[:, None]))
    unit = np.eye(b.shape[1])
    try:
        x, y = solve_continuous_are(a, b, c.T @ c, unit), solve_continuous_are(a.T, c.T, b @ b.T, unit)
    except (np.linalg.LinAlgError, ValueError):
        # Its pencil has eigenvalues too near the axis for it, or is too ill-conditioned to be put in order.
        return exact_margin(machine, control, z)
    return float(1 / np.sqrt(1 + np.linalg.eigvals(x @ y).real.max()))


def exact_margin(machine: Machine, control: Any, z: np.ndarray) -> float:
    """ε_max of one configuration in 420 bits."""
    return float(MarginOracle(build_margin(machine, control), z[:1], z[1:], GAIN).value())


def cases(m: int, size: float) -> Iterator[Case]:
    """Objectives by name, and weights."""
    for name in ORDERS:
        yield name, name, None
    for first, rest, beta in MIXES:
        weights = (first, *([rest] * (m - 1)), beta * size)
        yield f"{first:g} w1 + {rest:g} wi + {beta:g} size ε", "V", weights


def gap(machine: Machine, control: Any, target: np.ndarray, scan: Scanned, case: Case) -> tuple[float, float]:
    """How much better the scan is, as a share of the scale, and how long the selection took, s."""
    _, objective, weights = case
    start = time.perf_counter()
    selection = flexopt.select(
        machine, target, objective=objective, weights=weights, control=control, gain=GAIN, workers=1
    )
    seconds = time.perf_counter() - start
    worst = shortfall(machine, control, scan, selection, scipy_margin)
    if worst > DECIDES:
        worst = shortfall(machine, control, scan, selection, exact_margin)
    return worst, seconds


def shortfall(machine: Machine, control: Any, scan: Scanned, selection: flexopt.Selection, margin: Any) -> float:
    """How much better the scan is than a selection, as a share of the scale, ε_max where told by `margin`."""
    problem, best = selection.problem, selection.best
    epsilon = margin(machine, control, best.z)
    allowed = np.ones(scan.epsilon.size, dtype=bool)
    worst = -math.inf
    for number, (each, size) in enumerate(
        zip(problem.sought, problem.objective_scales[problem.bounding :], strict=True)
    ):
        values = np.array(each.alpha) @ scan.w + each.beta * scan.epsilon
        ours = each.value(best.w, epsilon)
        if number < len(selection.kept):
            # The best that was found is to be no worse than the scan; what was kept of it is no more than stated.
            kept = selection.kept[number]
            worst = max(worst, (kept.at_least - ours) / size)
            ours = kept.best
        among = np.flatnonzero(allowed)
        if among.size:
            top = among[values[among].argmax()]
            confirmed = each.value(scan.w[:, top], margin(machine, control, scan.z[:, top]))
            worst = max(worst, (confirmed - ours) / size)
        if number < len(selection.kept):
            allowed &= values >= selection.kept[number].at_least
    return worst


def machines(seeds: Sequence[int]) -> Iterator[tuple[str, Machine, list[np.ndarray], int]]:
    """Random machines by their seeds, with targets; 0 is the excavator."""
    for seed in seeds:
        if seed == 0:
            excavator = flexopt.load("excavator")
            assert isinstance(excavator, Machine)
            yield "excavator", excavator, [np.array(target) for target in EXCAVATOR], 0
            continue
        rng = np.random.default_rng(seed)
        _, machine = random_machine(rng)
        targets: list[np.ndarray] = []
        while len(targets) < 3:
            targets.append(arm_at_rest(machine, regular_posture(rng, machine))[1])
        yield f"{seed}: {machine.name}", machine, targets, seed


def examined(
    points: int,
    n_targets: int,
    each: tuple[str, Machine, list[np.ndarray], int],
    controls: Sequence[str] = CONTROLS,
) -> list[tuple[str, str, str, str, float, float, str]]:
    """Rows: machine, target, control, case, gap, seconds, failure."""
    name, machine, targets, seed = each
    rows: list[tuple[str, str, str, str, float, float, str]] = []
    for number, target in enumerate(targets[:n_targets]):
        for control in controls:
            try:
                scan = scanned(machine, target, control, points, 1000 * seed + number)
                sizes = (
                    build_measures(machine, control)
                    .w.call([scan.z[:1], scan.z[1:], build_measures(machine).plant.parameter_values])[1]
                    .full()
                )
                size = float(np.median(sizes.sum(axis=0)))
            except FlexoptError as error:
                rows.append((name, str(number), control, "scan", math.nan, 0.0, str(error)[:200]))
                continue
            for case in cases(scan.w.shape[0], size):
                try:
                    off, seconds = gap(machine, control, target, scan, case)
                    rows.append((name, str(number), control, case[0], off, seconds, ""))
                except Exception as error:
                    sentence = str(error) if isinstance(error, FlexoptError) else traceback.format_exc()
                    rows.append((name, str(number), control, case[0], math.nan, 0.0, sentence[:300]))
    return rows


def main() -> None:
    """Print the worst gaps, and every failure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--machines", type=int, default=50, help="random ones, with the seeds 1, 2, …")
    parser.add_argument("--seeds", type=int, nargs="*", help="these in place of them and the excavator; 0: excavator")
    parser.add_argument("--targets", type=int, default=3)
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    rows: list[tuple[str, str, str, str, float, float, str]] = []
    work = functools.partial(examined, options.points, options.targets)
    context = get_context("spawn")
    with context.Pool(options.workers, maxtasksperchild=1) as pool:
        for done in pool.imap(work, machines(range(options.machines + 1) if options.seeds is None else options.seeds)):
            rows += done
            worst = max((row[4] for row in done if not math.isnan(row[4])), default=math.nan)
            seconds = sum(row[5] for row in done)
            print(f"{done[0][0]:<40} worst gap {worst:+.1e}   {seconds:6.1f} s in select", flush=True)
            for row in done:
                if row[6] or row[4] > 1e-7:
                    print(f"    {row[1]} {row[2]:<10} {row[3]:<34} {row[4]:+.2e} {row[6]}", flush=True)
    gaps = sorted((row for row in rows if not row[6]), key=lambda row: -row[4])
    failed = [row for row in rows if row[6]]
    shown = [("machine", "target", "control", "objective", "scan − selection, share of the scale")]
    shown += [(*row[:4], f"{row[4]:+.1e}") for row in gaps[:5]]
    print(table(f"{len(rows)} selections, {len(failed)} failures", shown))


if __name__ == "__main__":
    main()
