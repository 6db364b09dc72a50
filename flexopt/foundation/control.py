"""The word that says how forces at the end-point become joint commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexopt.foundation.quantities import Quantity, accepting

# "inverse", "transpose" or "damped:LAMBDA", as `check_control` gives it.
Control = str
CONTROLS: tuple[Control, ...] = ("inverse", "transpose")
DAMPED = "damped"
DAMPING_MAX = 1e9
# Of Kp, Kv and Ki that make of the end-point's error the rate which velocity-served joints are asked for.
RATE_GAIN_UNITS = ("1/s", "", "1/s²")


@accepting({"type": "string", "pattern": rf"^({'|'.join(CONTROLS)}|{DAMPED}:.+)$"})
def check_control(value: Any) -> Control:
    """How forces at the end-point become joint commands: `inverse`, `transpose`, or `damped:LAMBDA` with λ > 0.

    λ is in the unit of Jv's entries. It comes out in its shortest form, so that equal controls are equal words.
    """
    if isinstance(value, str) and value in CONTROLS:
        return value
    method, _, number = value.partition(":") if isinstance(value, str) else ("", "", "")
    words = "must be inverse, transpose or damped:LAMBDA, such as damped:0.1"
    if method != DAMPED:
        raise ValueError(words)
    try:
        damping = Quantity("", above=0.0, high=DAMPING_MAX)(float(number))
    except ValueError:
        sentence = f"LAMBDA is a number above 0 and at most {DAMPING_MAX:g} in the unit of Jv's entries"
        raise ValueError(f"{words}; {sentence}") from None
    return f"{DAMPED}:{repr(damping).removesuffix('.0')}"


def control_method(control: Control) -> str:
    """A control without its number: `inverse`, `transpose` or `damped`."""
    return control.partition(":")[0]


def control_damping(control: Control) -> float | None:
    """λ of a damped control, None of any other."""
    return float(control.partition(":")[2]) if control_method(control) == DAMPED else None


def gain_units(control: Control, joint_units: Sequence[str]) -> tuple[str, str, str]:
    """Units of Kp, Kv and Ki: what makes of the end-point's error, m, the force f that Jvᵀ or Jv⁺ maps to the joints.

    Jv⁺ is in rad/m of hinges, so that f is in N m² there, and 1 of slides; an arm that has both has both units.
    """
    slides, hinges = ("N/m", "N s/m", "N/(m s)"), ("N m", "N m s", "N m/s")
    if control == "transpose" or set(joint_units) == {"m"}:
        return slides
    if set(joint_units) == {"rad"}:
        return hinges
    kp, kv, ki = (f"{of_hinges} or {of_slides}" for of_hinges, of_slides in zip(hinges, slides, strict=True))
    return kp, kv, ki


def damping_unit(joint_units: Sequence[str]) -> str:
    """Unit of a damping constant that all joints share: of arms of hinges, of slides, of both."""
    return " or ".join(dict.fromkeys("N m s/rad" if unit == "rad" else "N s/m" for unit in joint_units))


def limit_unit(joint_units: Sequence[str], per: str = "") -> str:
    """Of what drives may give, and with `per` = "/s" of how fast that changes; of hinges, of slides, of both."""
    return " or ".join(dict.fromkeys(f"{'N m' if unit == 'rad' else 'N'}{per}" for unit in joint_units))
