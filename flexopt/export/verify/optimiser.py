"""The posture optimiser of a bundle: its answers beside IPOPT's, faulty calls, instructions on emulated processors.

In: a `Bench`. Out: findings. Calls and answers go through files to the bundle's own driver.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np

from flexopt.export.optimiser import FIRST_FAILURE, STARTS, TOLERANCES, bounds_of
from flexopt.export.optimiser_part import LOSS, OptimiserPart, ReferenceProblem, draw_target
from flexopt.export.verify import replay
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable
from flexopt.export.verify.tools import StepFailed, run, sanitizing_compiler
from flexopt.foundation.arrays import Array
from flexopt.foundation.writing import write_file
from flexopt.plant.reach import outer_reach

PART = "optimiser"
PROBLEMS, SEED, FUZZ_SEED = 24, 40, 41
# Each call costs thousands of times what another function's does, and more so under sanitizers.
FUZZ_SHARE, FUZZ_BUDGET = 10, 60
REACHED = 0.7
INSTRUCTIONS = 5_000_000
SHARE = 0.99
NULL_PROBLEM, NULL_START, NULL_OPTIONS, NULL_WORKSPACE, NULL_RESULT, MISALIGNED = (1 << k for k in range(6))

# Runs the driver: (sources, name of its input, name of its output).
Runner = Callable[[Path, str, str], None]


@dataclass(frozen=True)
class Calls:
    """Calls, one row each.

    Attributes:
        words: faults, budget, own starts, evaluations until the deadline (0: none).
        tolerance, target, lower, upper, margin, weights, parameters, start: as the C structures have them.
    """

    words: np.ndarray
    tolerance: Array
    target: Array
    lower: Array
    upper: Array
    margin: Array
    weights: Array
    parameters: Array
    start: Array

    def reals(self) -> Array:
        """What the driver reads after the words."""
        parts = (self.tolerance, self.target, self.lower, self.upper, self.margin, self.weights, self.parameters)
        return np.hstack([*parts, self.start])


@dataclass(frozen=True)
class Solved:
    """What the driver answered.

    Attributes:
        calibration, workspace: ticks of a known number of instructions; bytes.
        status, ticks, untouched, cost, iterations, stack: one for each call.
        z, value, scale, target_error: of each result.
    """

    calibration: int
    workspace: int
    status: np.ndarray
    ticks: np.ndarray
    untouched: np.ndarray
    cost: np.ndarray
    iterations: np.ndarray
    stack: np.ndarray
    z: Array
    value: Array
    scale: Array
    target_error: Array

    @property
    def instructions(self) -> Array:
        """Of each call; meaningless on the host, which has no such clock."""
        return self.ticks * (replay.CALIBRATION / max(1, self.calibration))


def of(bench: Bench) -> OptimiserPart:
    """The part."""
    return bench.library.standalone[PART]


def agreement(bench: Bench, runner: Runner, *, counts: bool = False, bar: float = math.inf) -> Finding:
    """Random problems and starts; with `counts` instructions and stack, too, and no more instructions than `bar`."""
    part = of(bench)
    count = min(PROBLEMS, bench.inputs)
    vectors = part.vectors(count, SEED)
    calls = _problems(part, vectors)
    alone = replace(calls, words=calls.words | np.array([NULL_START, 0, 0, 0], np.int32))
    solved = solve(bench, calls, runner)
    lost, faults = _compared(bench, vectors, solved, "problem")
    lost_alone, faults_alone = _compared(bench, vectors, solve(bench, alone, runner), "problem without a start")
    faults += faults_alone
    good, good_alone = (sum(each <= LOSS[part.real] for each in losses) for losses in (lost, lost_alone))
    if good < SHARE * count:
        worst = int(np.argmax(lost))
        faults.append(f"{count - good} of {count} answers are worse than IPOPT's, number {worst} by {lost[worst]:.2g}")
    converged = int((solved.status == part.sources.statuses["CONVERGED"]).sum())
    rows: list[tuple[object, ...]] = [
        ("problems", count),
        ("the same V as IPOPT's best, or a better one", good),
        ("and without a start", good_alone),
        ("largest loss of V / scale", float(max(0.0, *lost))),
        ("converged within the default budget", converged),
        ("cost, most (evaluations of V)", int(solved.cost.max())),
        ("climbing steps, most", int(solved.iterations.max())),
        ("workspace, bytes", solved.workspace),
    ]
    sentence = f"{good} of {count} answers as good as IPOPT's best or better, none off its target"
    if counts:
        most = int(solved.instructions.max())
        rows += [
            ("instructions, most", most),
            ("instructions, median", int(np.median(solved.instructions))),
            ("stack of a call, bytes (painted)", int(solved.stack.max())),
        ]
        sentence += f"; {most:,} instructions at most"
        faults += [f"{most:,} instructions, allowed {bar:,}"] if most > bar else []
    return Finding(sentence, faults, [FindingTable("Posture optimiser", ("what", "number"), tuple(rows))])


def _compared(
    bench: Bench, vectors: tuple[ReferenceProblem, ...], solved: Solved, name: str
) -> tuple[list[float], list[str]]:
    """How much V is lower than IPOPT's, of the larger scale of the two, and which answers are not feasible."""
    part, lost, faults = of(bench), list[float](), list[str]()
    names = {value: name for name, value in part.sources.statuses.items()}
    for k, vector in enumerate(vectors):
        if solved.status[k] >= FIRST_FAILURE:
            lost.append(math.inf)
            continue
        value, error, sine = _exact(part, vector.weights, solved.z[k], vector.target)
        # Near singular postures |a||b|, and with it what rounding hides, is far larger than where most starts lie.
        lost.append((vector.value - value) / max(vector.scale, solved.scale[k]))
        if error > part.on_target or sine < part.at.singularity_margin**2 - _rounding(bench):
            faults.append(f"{name} {k}: {names[int(solved.status[k])]}, but {error:.2g} m off the target")
    return lost, faults


def host_runner(bench: Bench, compiler: str, objects: list[Path], flags: Sequence[str] = ("-O2",)) -> Runner:
    """The driver on this computer."""

    def launch(folder: Path, calls: str, answers: str) -> None:
        source = bench.folder / "test" / "optimiser_driver.c"
        driver = bench.program(f"optimiser-driver-{compiler}", compiler, [source, *objects], ["-std=c99", *flags])
        run([driver, folder / calls, folder / answers], folder=folder)

    return launch


def sanitized(bench: Bench, flags: tuple[str, ...]) -> Finding:
    """The self-test of the whole bundle and faulty calls of the optimiser, with sanitizers."""
    compiler = sanitizing_compiler(flags, bench.scratch)
    # The objects of the other faulty calls, too: the kernels take the compiler long.
    objects = list(bench.objects("sanitized", compiler, ["-std=c99", *flags]).values())
    source = bench.folder / "test" / "selftest.c"
    selftest = bench.program("selftest-sanitized", compiler, [source, *objects], ["-std=c99", *flags])
    said = run([selftest], folder=bench.scratch)
    faults = [] if "all passed" in said.out else ["the self-test does not say that all passed"]

    found = faulty_calls(bench, host_runner(bench, compiler, objects, flags))
    sentence = f"self-test and {found.sentence} with {compiler}: no sanitizer complained"
    return Finding(sentence, [*faults, *found.faults], found.tables)


def faulty_calls(bench: Bench, runner: Runner) -> Finding:
    """Calls with bad pointers and absurd numbers: no silent success, no result written on failure."""
    part = of(bench)
    calls = _faulty(bench, max(1, bench.fuzz_calls // FUZZ_SHARE))
    solved = solve(bench, calls, runner)
    names = sorted(part.sources.statuses.items(), key=lambda item: item[1])
    rows = tuple((name, int((solved.status == value).sum())) for name, value in names)
    sentence = f"{len(calls.words)} faulty calls, no silent success, refused results untouched"
    table = FindingTable("Faulty calls, by the status they got", ("status", "calls"), rows)
    return Finding(sentence, _judged(bench, calls, solved), [table])


def _problems(part: OptimiserPart, vectors: tuple[ReferenceProblem, ...]) -> Calls:
    calls = default_calls(part, len(vectors))
    calls.target[:] = [vector.target for vector in vectors]
    calls.weights[:] = [vector.weights for vector in vectors]
    calls.start[:] = [vector.start for vector in vectors]
    return calls


def default_calls(part: OptimiserPart, count: int) -> Calls:
    """The machine's own problem, target and start 0."""
    plant = part.at.plant
    limits = bounds_of(part.at.machine)
    parameters = () if part.at.baked else part.at.parameters.values

    def rows(values: object) -> Array:
        return np.tile(np.asarray(values, float), (count, 1))

    return Calls(
        words=np.tile(np.array([0, part.sources.budget, STARTS, 0], np.int32), (count, 1)),
        tolerance=rows([TOLERANCES[part.real][0]]),
        target=rows([0.0] * plant.n_task),
        lower=rows([low for low, _ in limits]),
        upper=rows([high for _, high in limits]),
        margin=rows([part.at.singularity_margin**2]),
        weights=rows([1.0] * plant.n_passive),
        parameters=rows(parameters),
        start=rows([0.0] * len(limits)),
    )


def solve(bench: Bench, calls: Calls, runner: Runner) -> Solved:
    """Put the calls to the driver and read what it answers."""
    real = np.float32 if bench.single else np.float64
    reals = calls.reals()
    kind = np.dtype([("words", np.int32, (4,)), ("reals", real, (reals.shape[1],))])
    records = np.zeros(len(reals), kind)
    records["words"] = calls.words
    with np.errstate(over="ignore", under="ignore"):
        records["reals"] = reals
    write_file(bench.scratch / "problems.bin", records.tobytes())
    runner(bench.scratch, "problems.bin", "solved.bin")
    data, n_z = (bench.scratch / "solved.bin").read_bytes(), calls.start.shape[1]
    kind = np.dtype([("words", np.uint32, (6,)), ("reals", real, (n_z + 6,))])
    if len(data) != 8 + len(reals) * kind.itemsize:
        raise StepFailed("the optimiser's driver did not answer every call")
    head, answers = np.frombuffer(data, np.uint32, 2), np.frombuffer(data, kind, offset=8)
    words, out = answers["words"], answers["reals"].astype(np.float64)
    return Solved(
        int(head[0]), int(head[1]), words[:, 0], words[:, 1], words[:, 2] != 0, words[:, 3], words[:, 4], words[:, 5],
        out[:, :n_z], out[:, n_z], out[:, n_z + 1], out[:, n_z + 2],
    )  # fmt: skip


def _exact(part: OptimiserPart, weights: Array, z: Array, target: Array) -> tuple[float, float, float]:
    """V, |r − target| and the squared sine at z, by flexopt's own Functions."""
    plant = part.at.plant
    at = [ca.DM(z[: plant.n_base].tolist()), ca.DM(z[plant.n_base :].tolist()), plant.parameter_values]
    w, _, r = part.at.measures.w.call(at)
    sine = plant.singularity_sine_squared.call(at)[0]
    error = float(np.abs(r.full().ravel() - target).max())
    return float(weights @ w.full().ravel()), error, float(sine)


def _rounding(bench: Bench) -> float:
    return 1e-4 if bench.single else 1e-10


def _faulty(bench: Bench, count: int) -> Calls:
    """Calls of which most have a bad pointer or some absurd numbers; small budgets, some deadlines."""
    part, rng = of(bench), np.random.default_rng(FUZZ_SEED)
    calls = default_calls(part, count)
    plant = part.at.plant
    calls.target[:] = rng.uniform(-1.2, 1.2, calls.target.shape) * outer_reach(plant)[1]
    if not plant.closed_form:
        # Most points of such a box are out of reach where the placement is bound or the task has orientation rows.
        for k in np.flatnonzero(rng.random(count) < REACHED):
            calls.target[k] = draw_target(plant, rng)
    calls.start[:] = rng.uniform(-4, 4, calls.start.shape)
    calls.words[:, 1] = rng.integers(1, FUZZ_BUDGET, count)
    calls.words[:, 2] = rng.integers(0, 3, count)
    calls.words[:, 3] = np.where(rng.random(count) < 0.25, rng.integers(1, FUZZ_BUDGET, count), 0)
    narrow = rng.random(count) < 0.3
    calls.lower[narrow, 0], calls.upper[narrow, 0] = rng.uniform(-3, 0, narrow.sum()), rng.uniform(0, 3, narrow.sum())
    pointers = rng.random(count) < 0.15
    calls.words[pointers, 0] = 1 << rng.integers(0, 6, pointers.sum())
    wild = rng.random(count) < 0.05
    calls.words[wild, 1] = rng.choice([-1, 0, -(2**31), 2**31 - 1], wild.sum())
    absurd = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e6, 2e6, 1e30, *(
        [1e-45, -3.4e38] if bench.single else [5e-324, -1.7e308])]  # fmt: skip
    for table in (calls.tolerance, calls.target, calls.lower, calls.upper, calls.margin, calls.weights,
                  calls.parameters, calls.start):  # fmt: skip
        if table.shape[1]:
            some = np.flatnonzero(rng.random(count) < 0.08)
            table[some, rng.integers(0, table.shape[1], some.size)] = rng.choice(absurd, some.size)
    return calls


def _judged(bench: Bench, calls: Calls, solved: Solved) -> list[str]:
    """What is wrong with the answers to faulty calls."""
    part = of(bench)
    status, ok, faults = part.sources.statuses, solved.status < FIRST_FAILURE, list[str]()
    single = np.float32 if bench.single else np.float64

    def note(which: np.ndarray, sentence: str) -> None:
        if which.any():
            faults.append(f"{int(which.sum())} calls {sentence}, such as number {int(which.argmax())}")

    with np.errstate(all="ignore"):
        given = calls.reals().astype(single).astype(float)
        lower, upper = (side.astype(single).astype(float) for side in (calls.lower, calls.upper))
    pointer = calls.words[:, 0]
    finite = np.isfinite(given[:, : given.shape[1] - calls.start.shape[1]]).all(axis=1)
    finite &= np.isfinite(given).all(axis=1) | (pointer == NULL_START)
    note(~np.isin(solved.status, list(status.values())), "gave a status that is none")
    note(~ok & ~solved.untouched, "that were refused wrote a result")
    note(ok & ~np.isfinite(np.column_stack([solved.z, solved.value])).all(axis=1), "succeeded with what is not finite")
    note(ok & ~np.isin(pointer, [0, NULL_START]), "with a bad pointer succeeded")
    bad = np.isin(pointer, [NULL_PROBLEM, NULL_OPTIONS, NULL_WORKSPACE, NULL_RESULT])
    note(bad & (solved.status != status["NULL_POINTER"]), "with a NULL pointer were not refused as such")
    note((pointer == MISALIGNED) & (solved.status != status["BAD_WORKSPACE"]), "with a bad workspace went through")
    note(ok & ~finite, "with a NaN or an infinite input succeeded")
    with np.errstate(invalid="ignore"):
        note(ok & ((solved.z < lower) | (solved.z > upper)).any(axis=1), "left the bounds")
    own = np.asarray(() if part.at.baked else part.at.parameters.values)
    sound = ok & (calls.parameters == own).all(axis=1)
    for k in np.flatnonzero(sound):
        size = 1.0 + float(np.abs(calls.target[k]).max() + np.abs(solved.z[k]).max())
        _, error, sine = _exact(part, calls.weights[k], solved.z[k], calls.target[k])
        allowed = part.on_target * size
        if error > allowed or sine < calls.margin[k, 0] - _rounding(bench):
            faults.append(f"call {k} succeeded {error:.2g} m off its target, or inside its margin")
    return faults
