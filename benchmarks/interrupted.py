"""Kill -9 at random moments, and full disks, over older good files: the older or the newer is there, whole.

Run: python -m benchmarks.interrupted [--kills 50] [--seed 0] [--only map,report,…] [--commands]

Each subject writes two versions of its files in turn, and is killed within one round of both; each file must then
be one of the two, byte for byte, and a bundle of C all of one. Then the newer version is written over the older where
no file may grow beyond a random size, and (as root, on Linux) on a disk with a random room left: an error in one
sentence, and the older file or the newer. `compile` kills processes that compile, and then reads the cache. With
--commands whole runs of the command line are killed, from their start on, which takes half an hour.

Bar: no broken file. POSIX only.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import casadi as ca
import numpy as np
from PIL import Image
from scipy.io import netcdf_file

import flexopt
from benchmarks.timing import table
from flexopt.article import reproduce
from flexopt.compiled import batch
from flexopt.compiled.compilers import find_compiler, library_suffix
from flexopt.compiled.storage import digest
from flexopt.errors import FlexoptError
from flexopt.export import bundle
from flexopt.export.bundle import MANIFEST, changed_files, read_manifest

Write = Callable[[Path, int], None]
POSTURE = (1.0, -1.4)
# Whole commands: the files they write, and their arguments for an older and a newer version.
COMMANDS = {
    "map": ("map excavator --points 40,40 --gain {gain} --out map.nc --plot map.png", ("gain", "4e5", "6e5")),
    "select": (
        "select excavator --end-point 0,1.6 --seed {seed} --out choice.json --plot choice.png",
        ("seed", "1", "2"),
    ),
    "simulate": (
        "simulate excavator --posture 1.0,-1.4 --kp {kp} --out run.csv --plot run.png --animate run.html",
        ("kp", "1e5", "1.1e5"),
    ),
    "report": ("report article --points 9 --duration {time} --out report", ("time", "1", "2")),
    "reproduce": ("reproduce --out reproduced", ("", "", "")),
    "export": ("export excavator --real {real} --out bundle --overwrite", ("real", "double", "float")),
    "fmu": (
        "export excavator --fmu loop.fmu --posture 1.0,-1.4 --fmi {version} --overwrite",
        ("version", "2.0", "3.0"),
    ),
}  # fmt: skip


@dataclass
class Counts:
    """What was seen of one subject."""

    trials: int = 0
    older: int = 0
    newer: int = 0
    broken: int = 0
    left: int = 0
    seconds: float = 0.0

    def row(self, name: str) -> tuple[str, ...]:
        """A row of the table."""
        numbers = (self.trials, self.older, self.newer, self.left, self.broken)
        return (name, *map(str, numbers), f"{self.seconds:.0f}")


def maps() -> Write:
    """A map: netCDF and PNG."""
    made = [flexopt.map_workspace(flexopt.load("excavator"), points=(9, 9), gain=gain) for gain in (4e5, 6e5)]

    def write(folder: Path, version: int) -> None:
        made[version].to_netcdf(folder / "map.nc")
        made[version].plot(folder / "map.png")

    return write


def runs() -> Write:
    """CSV, netCDF, PNG, GIF, HTML of a simulation."""
    made = [flexopt.simulate(flexopt.load("excavator"), POSTURE, duration=1.0, kp=kp) for kp in (1e5, 1.1e5)]

    def write(folder: Path, version: int) -> None:
        made[version].to_csv(folder / "run.csv")
        made[version].to_netcdf(folder / "run.nc")
        made[version].plot(folder / "run.png")
        made[version].animate(folder / "run.gif", speed=3)
        made[version].animate(folder / "run.html", speed=3)

    return write


def reports() -> Write:
    """HTML and JSON of a problem."""
    problem = flexopt.load_problem("article")
    made = [flexopt.report(problem, simulation={"duration": t}, points=5) for t in (1.0, 1.5)]
    return lambda folder, version: made[version].write(folder / "report") and None


def reproductions() -> Write:
    """HTML and JSON of the article."""
    made = [reproduce(points=(n, n)) for n in (21, 25)]
    return lambda folder, version: made[version].write(folder / "reproduced") and None


def bundles() -> Write:
    """A folder of C; its texts are made once, so that most of the time is spent in writing."""
    machine, made = flexopt.load("excavator"), bundle.render_bundle
    kept: dict[str, object] = {}

    def remembered(*arguments: object, **options: str) -> object:
        if options["real"] not in kept:
            kept[options["real"]] = made(*arguments, **options)
        return kept[options["real"]]

    mock.patch.object(bundle, "render_bundle", remembered).start()

    def write(folder: Path, version: int) -> None:
        real = ("double", "float")[version]
        flexopt.export_c(machine, folder / "bundle", parts=["kinematics", "controller"], real=real, overwrite=True)

    return write


def fmus() -> Write:
    """An FMU and its reference trajectory."""
    machine = flexopt.load("excavator")

    def write(folder: Path, version: int) -> None:
        flexopt.export_fmu(
            machine, folder / "loop.fmu", POSTURE, version=("2.0", "3.0")[version], duration=0.5, overwrite=True
        )

    return write


SUBJECTS = {
    "map": maps, "simulate": runs, "report": reports, "reproduce": reproductions, "export": bundles, "fmu": fmus,
}  # fmt: skip


def contents(folder: Path) -> dict[str, object]:
    """Path -> bytes of every file that is not being written; a bundle counts as one."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".flexopt-") for part in name.parts):
            if name.parts[0] == "bundle":
                of_bundle = found.setdefault("bundle", {})
                assert isinstance(of_bundle, dict)
                of_bundle[name.as_posix()] = path.read_bytes()
            else:
                found[name.as_posix()] = path.read_bytes()
    return found


def judge(counts: Counts, folder: Path, versions: list[dict[str, object]]) -> None:
    """Count what lies in a folder after something went wrong."""
    here = contents(folder)
    for name in versions[0]:
        if here.get(name) == versions[0][name]:
            counts.older += 1
        elif here.get(name) == versions[1][name]:
            counts.newer += 1
        else:
            counts.broken += 1
            print(f"BROKEN: {folder / name}", flush=True)
    counts.left += len(list(folder.rglob(".flexopt-*")))


def fork(work: Callable[[], int]) -> int:
    """A child that does `work` and ends with what it returns."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        status = 99
        with contextlib.suppress(BaseException):
            warnings.simplefilter("ignore")
            status = work()
        os._exit(status)
    return child


def kill_writers(write: Write, kills: int, rng: random.Random, folder: Path) -> tuple[Counts, list[dict[str, object]]]:
    """Kill processes that write the two versions in turn."""
    counts, versions = Counts(), []
    for version in (1, 0):
        started = time.perf_counter()
        write(folder, version)
        round_seconds = time.perf_counter() - started
        versions.insert(0, contents(folder))
    write(folder, 0)
    assert contents(folder) == versions[0], "the same input gives the same bytes"
    begin = time.perf_counter()

    def forever(first: int) -> int:
        while True:
            write(folder, first)
            write(folder, 1 - first)

    for k in range(kills):
        child = fork(lambda first=1 - k % 2: forever(first))
        time.sleep(rng.uniform(0, 2 * round_seconds))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        counts.trials += 1
        judge(counts, folder, versions)
    counts.seconds = time.perf_counter() - begin
    return counts, versions


def limit_sizes(
    write: Write, trials: int, rng: random.Random, folder: Path, versions: list[dict[str, object]]
) -> Counts:
    """Write the newer version where files may not grow beyond a random size."""
    counts = Counts()
    begin = time.perf_counter()
    sizes = [len(text) for text in versions[1].values() if isinstance(text, bytes)]
    sizes += [len(t) for texts in versions[1].values() if isinstance(texts, dict) for t in texts.values()]

    def limited(size: int) -> int:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        return refused(write, folder)

    for _ in range(trials):
        write(folder, 0)
        size = int(rng.uniform(0, max(sizes)))
        tell(counts, os.waitpid(fork(lambda size=size: limited(size)), 0)[1], f"at most {size} bytes")
        judge(counts, folder, versions)
    counts.seconds = time.perf_counter() - begin
    return counts


def refused(write: Write, folder: Path) -> int:
    """0 where writing is refused by one sentence."""
    try:
        write(folder, 1)
    except FlexoptError as error:
        return 0 if "\n" not in str(error) else 2
    return 1


def tell(counts: Counts, status: int, what: str) -> None:
    """Count a trial, and as broken one that did not end in a sentence."""
    counts.trials += 1
    if status:
        counts.broken += 1
        print(f"NO SENTENCE: {what}, status {status}", flush=True)


@contextlib.contextmanager
def small_disk(size: int) -> Generator[Path | None]:
    """A file system of so many bytes; None where none can be mounted."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder]
        if not sys.platform.startswith("linux") or subprocess.run(command, capture_output=True, check=False).returncode:
            yield None
            return
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


def fill_disks(write: Write, trials: int, rng: random.Random, versions: list[dict[str, object]]) -> Counts | None:
    """Write the newer version over the older on a disk with a random room left."""
    counts = Counts()
    begin = time.perf_counter()
    flat = [t for v in versions for e in v.values() for t in (e.values() if isinstance(e, dict) else [e])]
    needed = sum(4096 * (len(text) // 4096 + 2) for text in flat)
    for _ in range(trials):
        with small_disk(2 * needed + (1 << 20)) as disk:
            if disk is None:
                return None
            write(disk, 0)
            largest = max(len(text) for text in flat)
            room = 4096 * (int(rng.uniform(0, 0.9 * largest)) // 4096)
            free = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
            (disk / ".filler").write_bytes(bytes(max(0, free - room)))
            tell(counts, os.waitpid(fork(lambda disk=disk: refused(write, disk)), 0)[1], f"{room} bytes of room")
            (disk / ".filler").unlink()
            judge(counts, disk, versions)
    counts.seconds = time.perf_counter() - begin
    return counts


def kill_compilers(kills: int, rng: random.Random, folder: Path) -> Counts:
    """Kill processes that compile one library after the other; then look at the cache, and compile."""
    os.environ["FLEXOPT_CACHE"] = str(folder / "cache")
    counts, cache = Counts(), folder / "cache"
    begin = time.perf_counter()

    def function(k: int) -> ca.Function:
        x = ca.SX.sym("x")
        return ca.Function("f", [x], [ca.sin(k * x) + k])

    batch(function(0))  # the compiler is known

    def forever() -> int:
        rounds = random.SystemRandom()
        while True:
            batch(function(rounds.randrange(1, 10**9)))

    for _ in range(kills):
        child = fork(forever)
        time.sleep(rng.uniform(0, 0.6))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        counts.trials += 1
        for path in cache.iterdir():
            if path.suffix == library_suffix():
                whole = path.stem.partition("-")[2] == digest(path.read_bytes())
                counts.newer += whole
                counts.broken += not whole
        made = batch(function(1))
        counts.broken += made.compiled != (find_compiler() is not None)
        counts.broken += not np.allclose(made([[2.0]])[0], np.sin(2.0) + 1)
    counts.left = len([path for path in cache.iterdir() if path.name.startswith((".flexopt-", ".lock-"))])
    counts.seconds = time.perf_counter() - begin
    return counts


def complete(path: Path) -> bool:
    """Whether a file is whole, by its format."""
    data = path.read_bytes()
    try:
        if path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".nc":
            with netcdf_file(path, mmap=False) as file:
                return all(np.asarray(v.data).size >= 0 for v in file.variables.values())
        elif path.suffix == ".png":
            with Image.open(path) as image:
                image.load()
        elif path.suffix == ".csv":
            lines = data.decode().splitlines()
            return data.endswith(b"\n") and len({line.count(",") for line in lines}) == 1
        elif path.suffix == ".fmu":
            with zipfile.ZipFile(path) as archive:
                return archive.testzip() is None
        elif path.suffix == ".html":
            return data.rstrip().endswith(b"</html>")
        elif path.name == MANIFEST:
            return not changed_files(path.parent, read_manifest(path.parent))
    except Exception as error:
        print(f"{path}: {error}", flush=True)
        return False
    return True


def kill_commands(name: str, kills: int, rng: random.Random, folder: Path) -> Counts:
    """Kill whole runs of a command at moments from its start to its end."""
    counts = Counts()
    line, (word, older, newer) = COMMANDS[name]

    def start(value: str) -> subprocess.Popen[bytes]:
        words = line.format(**{word: value} if word else {}).split()
        code = "from flexopt.cli import main; main()"
        nowhere = subprocess.DEVNULL
        return subprocess.Popen(
            [sys.executable, "-c", code, *words], cwd=folder, start_new_session=True, stdout=nowhere, stderr=nowhere
        )

    for value in (newer, older):
        begin = time.perf_counter()
        assert start(value).wait() == 0, name
        lasts = time.perf_counter() - begin
    before = {k: v for k, v in contents(folder).items() if k != "bundle"}
    begin = time.perf_counter()
    for _ in range(kills):
        process = start(newer)
        time.sleep(rng.uniform(0, 1.1 * lasts))
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        counts.trials += 1
        for path in sorted(folder.rglob("*")):
            relative = path.relative_to(folder)
            if not path.is_file() or any(part.startswith(".flexopt-") for part in relative.parts):
                continue
            if before.get(relative.as_posix()) == path.read_bytes():
                counts.older += 1
            elif complete(path):
                counts.newer += 1
            else:
                counts.broken += 1
                print(f"BROKEN: {path}", flush=True)
    counts.left = len(list(folder.rglob(".flexopt-*")))
    counts.seconds = time.perf_counter() - begin
    return counts


def examine(subject: str, kills: int, rng: random.Random) -> list[tuple[str, ...]]:
    """Rows of one subject."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if subject == "compile":
            return [kill_compilers(kills, rng, folder).row("compile, killed")]
        write = SUBJECTS[subject]()
        counts, versions = kill_writers(write, kills, rng, folder)
        rows = [counts.row(f"{subject}, killed")]
        rows.append(limit_sizes(write, max(1, kills // 5), rng, folder, versions).row(f"{subject}, sizes limited"))
        filled = fill_disks(write, max(1, kills // 5), rng, versions)
        rows.append((f"{subject}, full disk", *["–"] * 6) if filled is None else filled.row(f"{subject}, full disk"))
        return rows


def main(arguments: list[str] | None = None) -> int:
    """Print the table; the number of broken files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--commands", action="store_true")
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    rng = random.Random(given.seed)
    names = [*COMMANDS] if given.commands else [*SUBJECTS, "compile"]
    rows: list[tuple[str, ...]] = []
    for name in given.only.split(",") if given.only else names:
        if given.commands:
            with tempfile.TemporaryDirectory() as folder:
                rows.append(kill_commands(name, given.kills, rng, Path(folder)).row(f"flexopt {name}, killed"))
        else:
            rows += examine(name, given.kills, rng)
        print("  ".join(rows[-1]), flush=True)
    header = ("what", "trials", "files older", "files newer", "left beside", "broken", "s")
    print(table("Interrupted over older good files", [header, *rows]))
    return sum(int(row[5]) for row in rows if row[5] != "–")


if __name__ == "__main__":
    sys.exit(min(main(), 1))
