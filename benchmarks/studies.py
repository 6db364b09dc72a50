"""Large studies: rate beside the compiled kernel alone, two engines, faults, selections side by side, overhead.

Run: python -m benchmarks.studies [rate] [engines] [faults] [selections] [overhead] [--runs 20] [--points 10000000]

Bars: at least 60 % of the kernel's rate to disk, on as many cores, in less than 600 MiB; through Dask at least 80 % of
the rate of processes; after each fault files that are byte for byte those of an undisturbed run; 1.8 times as many
selections with two processes as with one; an overhead for each chunk that does not grow. Linux only.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import flexopt
from benchmarks.interrupted import small_disk
from benchmarks.local_cluster import LocalCluster, local_cluster
from benchmarks.timing import table
from flexopt.large_studies.chunk import Finished, nothing
from flexopt.large_studies.engines import Engine, engine_of

WORKERS, ROUNDS = 2, 3
ENDS = ((0.1, 1.4), (-2.8, -0.3))


def postures(points: int, **changes: object) -> flexopt.Study:
    """Measures and their Jacobian at random postures of the excavator."""
    names = ("posture.boom", "posture.stick")
    vary = [{"of": name, "value": ends} for name, ends in zip(names, ENDS, strict=True)]
    given = {"quantities": ["w", "w_posture"], "vary": vary, "points": "random", "count": points} | changes
    return flexopt.Study(name="postures", machine="excavator", compute="measures", **given)


def kernel_rate(points: int) -> float:
    """Points in a second of the compiled Function alone, one call, as many threads."""
    measures = flexopt.build_measures(flexopt.load("excavator"))
    p = np.array(measures.plant.parameter_values).ravel()
    rng = np.random.default_rng(0)
    given = np.array([rng.uniform(*ends, points) for ends in ENDS])
    measures.quick_batch_with_gradient([0.0], given[:, :1000], p)
    begin = time.perf_counter()
    measures.quick_batch_with_gradient([0.0], given, p, threads=WORKERS)
    return points / (time.perf_counter() - begin)


@contextmanager
def empty_folder() -> Generator[Path]:
    """A folder for a study, removed afterwards."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("STUDIES_FOLDER")) as folder:
        yield Path(folder) / "study"


def study_rate(points: int, executor: str | None = None) -> float:
    """Points in a second of the whole call, from nothing to files."""
    with empty_folder() as folder:
        begin = time.perf_counter()
        flexopt.run_study(postures(points), folder, workers=WORKERS, executor=executor)
        return points / (time.perf_counter() - begin)


def memory_of(process: int) -> int:
    """Bytes of a process and its children; what several share counts once."""
    total, waiting = 0, [process]
    while waiting:
        here = waiting.pop()
        with contextlib.suppress(OSError, StopIteration, IndexError):
            lines = Path(f"/proc/{here}/smaps_rollup").read_text(encoding="utf-8").splitlines()
            total += 1024 * int(next(line for line in lines if line.startswith("Pss:")).split()[1])
            waiting += map(int, Path(f"/proc/{here}/task/{here}/children").read_text(encoding="utf-8").split())
    return total


def peak_of(arguments: list[str]) -> int:
    """Largest memory of a command and its children, looked at every 20 ms."""
    peak = 0
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:
            peak = max(peak, memory_of(process.pid))
            time.sleep(0.02)
        assert process.returncode == 0
    return peak


def rate(points: int) -> list[tuple[str, ...]]:
    """Row 1: in turns with the kernel alone, so that what else the machine does falls on both."""
    pairs = [(kernel_rate(points), study_rate(points)) for _ in range(ROUNDS)]
    ratios = sorted(study / kernel for kernel, study in pairs)
    program = f"import benchmarks.studies as s; s.study_rate({points})"
    peak = peak_of([sys.executable, "-c", program])
    told = ", ".join(f"{study / 1e6:.2f} of {kernel / 1e6:.2f}" for kernel, study in pairs)
    return [
        (f"{points:.0e} postures, w and Jacobian to disk / kernel", f"{ratios[len(ratios) // 2]:.2f}", "≥ 0.60",
         f"{WORKERS} processes; millions in a second, {told}"),
        ("peak memory of all processes, MiB", f"{peak / 2**20:.0f}", "< 600", "proportional set size, every 20 ms"),
    ]  # fmt: skip


def engines(points: int) -> list[tuple[str, ...]]:
    """Row 2: the same through a scheduler and two workers on this machine, after a first study of both."""
    with local_cluster(WORKERS) as cluster:
        study_rate(points // 10, cluster.address)
        pairs = [(study_rate(points), study_rate(points, cluster.address)) for _ in range(ROUNDS)]
    ratios = sorted(dask / alone for alone, dask in pairs)
    told = ", ".join(f"{dask / 1e6:.2f} of {alone / 1e6:.2f}" for alone, dask in pairs)
    return [("the same by Dask / by processes", f"{ratios[len(ratios) // 2]:.2f}", "≥ 0.80",
             f"{WORKERS} workers of one thread; millions in a second, {told}")]  # fmt: skip


def long_one() -> flexopt.Study:
    """Some seconds of loops, in 40 chunks."""
    vary = [
        {"of": "kp", "value": [1e3, 1e5], "scale": "log"},
        {"of": "stiffness", "factor": [0.5, 2.0]},
        {"of": "dead_time", "value": [0.0, 0.02]},
    ]
    return flexopt.Study(
        name="loops", machine="excavator", compute="outcome", points="sobol", count=40 * 512, chunk=512, vary=vary,
        posture=[0.0448, -2.0499], loop={"kv": 1e3},
    )  # fmt: skip


def contents(folder: Path) -> dict[str, bytes]:
    """Chunks, byte by byte."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.nc"))}


def driver(folder: Path, executor: str | None) -> subprocess.Popen[bytes]:
    """A process that carries the study out."""
    program = (
        "import benchmarks.studies as s, flexopt, sys\n"
        f"flexopt.run_study(s.long_one(), {str(folder)!r}, workers=2, executor={executor!r})\n"
    )
    return subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL)


def _kill_worker_of(process: subprocess.Popen[bytes]) -> None:
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    with contextlib.suppress(OSError, IndexError):
        os.kill(int(random.choice(children.read_text(encoding="utf-8").split())), signal.SIGKILL)


def disturbed(kind: str, folder: Path, seconds: float) -> str:
    """One run with a fault at a random moment; what the driver said."""
    if kind == "full disk":
        # Chunks take some 5 kB each, 8 of a file system.
        with small_disk(4096 * random.randrange(8, 80)) as disk:
            if disk is None:
                return "no disk can be mounted"
            try:
                flexopt.run_study(long_one(), disk / "study", workers=WORKERS)
                said = "there was room"
            except flexopt.StudyInterrupted as error:
                said = "stopped" if "cannot be written" in str(error) else str(error)
            except flexopt.WriteError:
                said = "not begun"
            if (disk / "study").exists():
                shutil.copytree(disk / "study", folder)
                # What was not begun whole is begun anew.
                if not (folder / "study.json").exists():
                    shutil.rmtree(folder)
            return said
    if kind == "chunk truncated":
        flexopt.run_study(long_one(), folder, workers=WORKERS)
        path = random.choice(sorted(folder.rglob("*.nc")))
        path.write_bytes(path.read_bytes()[: random.randrange(path.stat().st_size)])
        return "truncated"
    with local_cluster(WORKERS) if "Dask" in kind else contextlib.nullcontext() as cluster:
        process = driver(folder, cluster.address if isinstance(cluster, LocalCluster) else None)
        time.sleep(random.uniform(0.2, 1.0) * seconds)
        if kind.startswith("driver"):
            process.kill()
        elif isinstance(cluster, LocalCluster):
            (cluster.scheduler if "scheduler" in kind else random.choice(cluster.workers)).kill()
        else:
            _kill_worker_of(process)
        code = process.wait(120)
    return "went on" if code == 0 else "stopped"


KINDS = ("worker", "driver", "worker, Dask", "scheduler, Dask", "driver, Dask", "full disk", "chunk truncated")


def faults(runs: int) -> list[tuple[str, ...]]:
    """Row 3."""
    alike, said = 0, dict[str, list[str]]()
    with empty_folder() as folder:
        begin = time.perf_counter()
        assert driver(folder, None).wait() == 0
        seconds, expected = time.perf_counter() - begin, contents(folder)
    for k in range(runs):
        kind = KINDS[k % len(KINDS)]
        with empty_folder() as folder:
            how = disturbed(kind, folder, seconds)
            there = len(contents(folder)) if folder.exists() else 0
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                flexopt.run_study(long_one(), folder, workers=WORKERS)
            same = contents(folder) == expected
        alike += same
        said.setdefault(kind, []).append(f"{how} at {there}")
        print(
            f"  {kind}: {how}, {there} of 40 chunks; after resuming {'the same' if same else 'OTHER'} bytes", flush=True
        )
    return [(f"{runs} faults, byte-identical after resuming", str(alike), f"{runs}", ", ".join(KINDS))]


def constrained(count: int) -> flexopt.Study:
    """Selections with constraints at so many targets, a multiple of 40."""
    problem = flexopt.Problem(
        name="constrained", machine="excavator", target={"end_point": [0.0, 1.6]},
        selection={"base": [0.0], "starts": 8}, constraints={"manipulability": 0.3, "keep_out": [[0.5, 1.0]]},
    )  # fmt: skip
    vary = [
        {"of": "target.x", "value": [-0.4, 0.4], "count": 40},
        {"of": "target.y", "value": [1.0, 2.2], "count": count // 40},
    ]
    study = flexopt.Study(name="choices", problem="constrained", compute="selection", vary=vary)
    return study.with_subject(problem.with_machine(flexopt.load("excavator")))


def selections(count: int) -> list[tuple[str, ...]]:
    """Row 4."""
    seconds, found = dict[int, float](), dict[int, dict[str, bytes]]()
    counts = ""
    for workers in (1, WORKERS):
        with empty_folder() as folder:
            begin = time.perf_counter()
            result = flexopt.run_study(constrained(count), folder, workers=workers)
            seconds[workers], found[workers] = time.perf_counter() - begin, contents(folder)
            counts = ", ".join(f"{n} {word}" for word, n in result.statuses.items() if n)
    ran = f"{seconds[1]:.0f} s and {seconds[WORKERS]:.0f} s; {counts}; "
    ran += "the same bytes" if found[1] == found[WORKERS] else "OTHER BYTES"
    return [(f"{count} selections, 1 process / 2", f"{seconds[1] / seconds[WORKERS]:.2f}", "≥ 1.8", ran)]


def overhead(chunks: int = 10_000) -> list[tuple[str, ...]]:
    """Row 5: as an engine is driven, with no work at all."""
    rows: list[tuple[str, ...]] = []

    def timed(engine: Engine, name: str) -> None:
        times: list[float] = []

        def seen(_: Finished) -> None:
            times.append(time.perf_counter())

        engine(nothing, "", "", range(chunks), seen)
        steps = np.diff(times)
        first, last = (1e3 * steps[part].mean() for part in (slice(1000, 3000), slice(-2000, None)))
        rows.append(
            (f"overhead of a chunk, {name}, ms", f"{1e3 * steps.mean():.3f}", "",
             f"{chunks} empty chunks; {first:.3f} of chunks 1000 to 3000, {last:.3f} of the last 2000")
        )  # fmt: skip

    with engine_of(None, WORKERS) as engine:
        timed(engine, "processes")
    with local_cluster(WORKERS) as cluster, engine_of(cluster.address, WORKERS) as engine:
        timed(engine, "Dask")
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies", description=__doc__.splitlines()[0])
    parser.add_argument("row", nargs="*", default=["rate", "engines", "faults", "selections", "overhead"])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--selections", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random.seed(options.seed)
    work: dict[str, Callable[[], list[tuple[str, ...]]]] = {
        "rate": lambda: rate(options.points), "engines": lambda: engines(options.points),
        "faults": lambda: faults(options.runs), "overhead": overhead,
        "selections": lambda: selections(options.selections),
    }  # fmt: skip
    lines: list[tuple[str, ...]] = [("what", "now", "bar", "what ran")]
    for row in options.row:
        lines += work[row]()
    print(table(f"Large studies; load of the machine {os.getloadavg()[0]:.1f} at the end", lines))


if __name__ == "__main__":
    main()
