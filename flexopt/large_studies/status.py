"""What became of a point: points that fail are data."""

from __future__ import annotations

import numpy as np

from flexopt.errors import FlexoptError, InputError, NoSolutionFound, SingularPosture, UnreachableTarget

# Words of a file's `flag_meanings`, by number.
WORDS = ("ok", "singular", "no_equilibrium", "no_number", "unreachable", "refused", "no_solution", "failed")
OK, SINGULAR, NO_EQUILIBRIUM, NO_NUMBER, UNREACHABLE, REFUSED, NO_SOLUTION, FAILED = range(len(WORDS))
# How a file says which number is which word.
FLAGS = {"flag_values": np.arange(len(WORDS), dtype=np.int8), "flag_meanings": " ".join(WORDS)}
# Bytes of a reason that are kept.
REASON_MAX = 160
SENTENCES = {
    "ok": "computed",
    "singular": "Jv loses rank there, so that there are no measures",
    "no_equilibrium": "the springs do not hold the machine there",
    "no_number": "the numbers there leave the range of doubles",
    "unreachable": "the arm does not reach the target",
    "refused": "the numbers of the point are not usable",
    "no_solution": "no solve passed the independent checks",
    "failed": "the computation broke off",
}


def status_of(error: Exception) -> tuple[int, str]:
    """The number and the reason of a point whose computation raised."""
    text = " ".join(str(error).split())
    for kind, status in (
        (UnreachableTarget, UNREACHABLE), (SingularPosture, SINGULAR), (InputError, REFUSED),
        (NoSolutionFound, NO_SOLUTION), (FlexoptError, FAILED),
    ):  # fmt: skip
        if isinstance(error, kind):
            return status, text
    return FAILED, f"{type(error).__name__}: {text}"
