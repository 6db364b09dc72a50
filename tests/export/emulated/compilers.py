"""What strict compilers report of a bundle, and the numbers of what each of them makes.

In: a `Bench` and a compiler. Out: findings.
"""

from __future__ import annotations

from pathlib import Path

from flexopt.export.verify import host
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding
from flexopt.export.verify.tools import run

COMPILERS = {"gcc": "g++", "clang": "clang++"}
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wstrict-prototypes", "-Werror")
# What a compiler warns of once it optimises does not depend on the standard: the first is compiled optimised.
STANDARDS = ("c99", "c11")


def build_strictly(bench: Bench, compiler: str) -> None:
    """Compile all C and C++ of the bundle, warnings as errors, and run the self-test and the example.

    Raises:
        StepFailed: a warning, or a program that does not end with 0.
    """
    for standard in STANDARDS:
        # The programs print numbers as double; only the library is free of it.
        flags = [f"-std={standard}", "-O1", *STRICT]
        for source in (bench.folder / "test" / "selftest.c", bench.folder / "examples" / "main.c"):
            objects = _objects(bench, compiler, standard)
            program = bench.program(f"{source.stem}-{compiler}-{standard}", compiler, [source, *objects], flags)
            run([program], folder=bench.scratch)
    sources = [bench.folder / "test" / "cpp_check.cpp", bench.folder / "examples" / "ros2_node.cpp"]
    flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    for source in filter(Path.exists, sources):
        objects = _objects(bench, compiler, STANDARDS[0])
        program = bench.program(f"{source.stem}-{compiler}", COMPILERS[compiler], [source, *objects], flags)
        run([program], folder=bench.scratch)


def agreement(bench: Bench, compiler: str) -> Finding:
    """Compare what a compiler makes of the library with Python."""
    sources = [bench.folder / "test" / "driver.c", *_objects(bench, compiler, STANDARDS[0])]
    return host.agreement(bench, bench.program(f"driver-{compiler}", compiler, sources, ["-std=c99", "-O2"]))


def _objects(bench: Bench, compiler: str, standard: str) -> list[Path]:
    flags = [f"-std={standard}", "-O2" if standard == STANDARDS[0] else "-O0", *STRICT]
    # Of precision in single-precision bundles.
    flags += ["-Wdouble-promotion"] * bench.single
    flags += ["-Wunsuffixed-float-constants"] * (bench.single and compiler == "gcc")
    return list(bench.objects(f"strict-{compiler}-{standard}", compiler, flags).values())
