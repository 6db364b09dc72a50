"""`python -m tests.golden [NAME…]` prints what differs from the kept numbers; `--write` keeps new ones.

NAME is a case (`evaluate-excavator`), a call (`evaluate`) or a pattern (`*-excavator`); without one, all cases run.
"""

from __future__ import annotations

import argparse
import os
import sys
from fnmatch import fnmatchcase

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")

from tests.golden.calls import CASES, computed  # noqa: E402  (threads are said before NumPy comes in)
from tests.golden.keeping import differences, forget, keep  # noqa: E402


def main() -> int:
    """Run the cases that are asked for; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--write", action="store_true", help="keep the numbers instead of comparing them")
    parser.add_argument("--quick", action="store_true", help="leave out the long cases")
    parser.add_argument("--seconds", action="store_true", help="print how many seconds of a processor each case takes")
    given = parser.parse_args()
    names = [name for name, case in CASES.items() if _asked(name, given.names) and not (given.quick and case.long)]
    if not names:
        parser.error(f"no case matches {' '.join(given.names)}")
    differing = 0
    for name in names:
        start = sum(os.times()[:4])
        try:
            now = computed(name)
        except Exception as error:  # a call that fails differs, and the others still run
            differing += 1
            print(f"{name} fails: {type(error).__name__}: {error}", flush=True)
            continue
        if given.seconds:
            print(f"{name}: {sum(os.times()[:4]) - start:.2f} s", flush=True)
        if given.write:
            keep(name, now)
            continue
        found = differences(name, now)
        differing += bool(found)
        for difference in found:
            print(f"{name} {difference}", flush=True)
    if given.write and not given.names and not given.quick:
        forget(set(CASES))
    print(f"{len(names)} cases, {'written' if given.write else f'{differing} differ'}")
    return int(bool(differing))


def _asked(name: str, patterns: list[str]) -> bool:
    return not patterns or any(fnmatchcase(name, pattern) or name.partition("-")[0] == pattern for pattern in patterns)


sys.exit(main())
