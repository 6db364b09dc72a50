"""What files and arguments say about a choice, each by itself: words, numbers and their ranges."""

from __future__ import annotations

from typing import Any, Literal

from flexopt.foundation.nearest import nearest
from flexopt.foundation.quantities import Quantity, a_list, accepting, each_named, entries, whole_number

Elbow = Literal["up", "down"]
ELBOWS: tuple[Elbow, ...] = ("up", "down")
# How the targets that share a placement count: the worst one, or all by their shares.
Combine = Literal["worst", "weighted"]
COMBINES: tuple[Combine, ...] = ("worst", "weighted")
# What a selection assumes where nothing else is asked for; see `flexopt.selection.assumed`.
ASSUMPTIONS = ("ground", "limits", "reach")
EVERYTHING, NOTHING = "everything", "nothing"
SINGULARITY_MARGIN_DEG = 10.0
# The best maxima of the excavator's ε_max differ by 4e-5 of it and more.
SLACK = 1e-5
STARTS_MAX = 10_000
TARGETS_MAX = 1000
# Objectives that are what the real loop does, as of `flexopt.Outcome`.
DECAY, ALLOWED_GAIN, DELAY_MARGIN = "decay", "allowed_gain", "delay_margin"
ALLOWANCE, RADIUS, SETTLING, SWING = "allowance", "radius", "settling", "swing"
OUTCOMES = (DECAY, ALLOWED_GAIN, DELAY_MARGIN, ALLOWANCE, RADIUS, SETTLING, SWING)
MODES_MAX = 99
OBJECTIVE_WORDS = (*(f"w{mode}" for mode in range(1, MODES_MAX + 1)), "V", "epsilon_max", *OUTCOMES)
WEIGHT = Quantity("", low=0.0, high=1e6)
BASE_RATE, BASE_ACCELERATION = Quantity("m/s", above=0.0, high=1e3), Quantity("m/s²", above=0.0, high=1e4)


@accepting({"type": "string"})
def check_objective(value: Any) -> str:
    """`w1`, `w2`, …, `V`, `epsilon_max`, one of `OUTCOMES`, or several of them in order, separated by commas."""
    words = value.replace(" ", "").split(",") if isinstance(value, str) else []
    unknown = [word for word in words if word not in OBJECTIVE_WORDS]
    if not words or unknown:
        near = [nearest(word, OBJECTIVE_WORDS) for word in unknown]
        raise ValueError(
            f"must be w1, w2, … (one mode), V (a weighted sum) or epsilon_max, of a loop {', '.join(OUTCOMES)}, or "
            "several of them in order of importance, separated by commas"
            + "".join(f"; did you mean {word!r}?" for word in dict.fromkeys(near) if word is not None)
        )
    if len(set(words)) < len(words):
        raise ValueError("names the same objective twice")
    return ",".join(words)


def of_loop(objective: Any) -> bool:
    """Whether an objective, or one of several in order, is a measure of the loop."""
    return isinstance(objective, str) and not set(OUTCOMES).isdisjoint(objective.split(","))


def asks_for_loop(objective: Any, constraints: Any) -> bool:
    """Whether a choice is by what the real loop does: its objective, or a constraint."""
    return of_loop(objective) or getattr(constraints, "outcome", None) is not None


@accepting({"type": "string"})
def check_assume(value: Any) -> str:
    """`everything`, `nothing`, or some of `ASSUMPTIONS`, separated by commas."""
    words = value.replace(" ", "").split(",") if isinstance(value, str) else []
    if words not in ([EVERYTHING], [NOTHING]) and not (words and set(words) <= set(ASSUMPTIONS)):
        raise ValueError(f"must be {EVERYTHING}, {NOTHING}, or some of {', '.join(ASSUMPTIONS)}, separated by commas")
    return ",".join(dict.fromkeys(words))


def assumes(assume: str, name: str) -> bool:
    """Whether a word of `check_assume` takes one of `ASSUMPTIONS` in."""
    return assume == EVERYTHING or name in assume.split(",")


@accepting(a_list(WEIGHT.accepts or {}, 1))
def check_weights(value: Any) -> tuple[float, ...]:
    """The weights α of V = Σ αi wi: non-negative, not all zero."""
    values = entries(value)
    if not values:
        raise ValueError("must be a list of numbers, one for each mode")
    weights = each_named(WEIGHT, values, [f"α{i + 1}" for i in range(len(values))])
    if not any(weights):
        raise ValueError("at least one weight must be positive")
    return weights


MARGIN_DEG = Quantity("°", low=0.01, high=80.0)
GAIN = Quantity("", above=0.0, high=1e15)
SEED = whole_number(0, 2**32 - 1, "2³² − 1")
SLACK_SHARE = Quantity("", low=1e-7, high=1.0)
STARTS = whole_number(1, STARTS_MAX)
