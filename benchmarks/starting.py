"""What a first use costs: the import, a whole `evaluate`, and a map whose code is not compiled yet.

Run: python -m benchmarks.starting

Processes are started in turn, byte code cached; each time is the least of its rounds. The unit of the first two is a
process that imports numpy, casadi and pydantic, and does nothing.
"""

from __future__ import annotations

import tempfile

from benchmarks.score import Row
from benchmarks.timing import fresh_process, table

BASE = "import numpy, casadi, pydantic"
EVALUATE = "import flexopt; flexopt.evaluate(flexopt.load('excavator'), (0.9929, -2.6306))"
COMMAND = "from flexopt.cli import main; main(['evaluate', 'excavator', '--posture', '0.9929,-2.6306'])"
MAP = """
import sys, time
import flexopt
machine = flexopt.load("excavator")
begin = time.perf_counter()
flexopt.map_workspace(machine, points=(int(sys.argv[1]), int(sys.argv[1])))
print(time.perf_counter() - begin)
"""
POINTS = 200


def rows(quick: bool) -> list[Row]:
    """Whole processes beside the imports that they cannot do without."""
    programs = {"base": BASE, "import": "import flexopt", "evaluate": EVALUATE, "command": COMMAND}
    least = dict.fromkeys(programs, float("inf"))
    for _ in range(2 if quick else 20):
        for name, program in programs.items():
            least[name] = min(least[name], fresh_process(program)[0])
    maps = []
    for _ in range(1 if quick else 3):
        with tempfile.TemporaryDirectory() as folder:
            points = str(8 if quick else POINTS)
            maps.append(float(fresh_process(MAP, points, environment={"FLEXOPT_CACHE": folder})[1]))
    unit, ran = least["base"], "Python"
    return [
        Row("import flexopt / numpy, casadi, pydantic", least["import"] / unit, 1.6, at_least=False, ran=ran),
        Row("evaluate from Python / the same", least["evaluate"] / unit, 3.0, at_least=False, ran="virtual machine"),
        Row("flexopt evaluate / the same", least["command"] / unit, 3.0, at_least=False, ran="virtual machine"),
        Row(
            f"first map of {POINTS} × {POINTS} points with an empty cache, s", min(maps), 5.0, at_least=False,
            ran="compiled where that pays",
        ),
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    lines = [("what", "measured", "bar"), *((row.what, f"{row.value:.2f}", f"{row.bar}") for row in rows(False))]
    print(table("First use", lines))


if __name__ == "__main__":
    main()
