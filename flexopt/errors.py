"""The errors that flexopt raises, and how their sentences are put together.

In: faults found anywhere in the package. Out: one exception tree under `FlexoptError`; every message names the
field, the value, its unit and what is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

# Lines of one message; more of them help nobody. The error's `faults` are all of them.
FAULTS_SHOWN = 100


@dataclass(frozen=True)
class Fault:
    """One thing wrong with an input: the field's path, the offending value as text (if any), and the sentence."""

    field: str
    sentence: str
    value: str | None = None

    def __str__(self) -> str:
        given = "" if self.value is None else f" = {self.value}"
        return f"{self.field}{given}: {self.sentence}"


class FlexoptError(Exception):
    """Root of every error that flexopt raises on purpose.

    Attributes:
        faults: each fault on its own, when the input had several.
        heading: what they are faults of (a call, a file).
    """

    def __init__(self, message: str, faults: Sequence[Fault] = (), heading: str = "") -> None:
        super().__init__(message)
        self.faults = tuple(faults)
        self.heading = heading

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready description of the error."""
        return {
            "type": type(self).__name__,
            "message": str(self),
            "faults": [{"field": f.field, "value": f.value, "sentence": f.sentence} for f in self.faults],
        }


class InputError(FlexoptError, ValueError):
    """An argument or option is not usable: wrong shape, not finite, out of its range, unknown word."""


class ModelError(InputError):
    """A machine or problem file (or the dictionary in its place) is not usable."""


class UnreachableTarget(InputError):
    """No posture puts the end-point on the target.

    Attributes:
        miss: how far outside the reach the target lies, m.
        base_intervals: intervals of the placement coordinate that would bring it within reach, m.
    """

    def __init__(self, message: str, *, miss: float, base_intervals: Sequence[tuple[float, float]] = ()) -> None:
        super().__init__(message)
        self.miss = miss
        self.base_intervals = tuple(base_intervals)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready description, with the miss and the placements that would do."""
        intervals = [list(interval) for interval in self.base_intervals]
        return super().to_dict() | {"miss": self.miss, "base_intervals": intervals}


class SingularPosture(InputError):
    """The rigid-body Jacobian loses rank, so the end-point cannot be driven in every direction.

    Attributes:
        joint: the joint that would lead out of the singularity fastest.
        angle: its value, rad (of a slide m).
    """

    def __init__(self, message: str, *, joint: str, angle: float) -> None:
        super().__init__(message)
        self.joint = joint
        self.angle = angle


class NotStabilizable(InputError):
    """No controller can stabilise the plant: a mode that does not decay escapes the inputs or the outputs.

    Attributes:
        mode: its eigenvalue (rad/s; dimensionless in discrete time).
        kind: which property fails, `"stabilizable"` (no input reaches the mode) or `"detectable"` (no output sees it).
    """

    def __init__(self, message: str, faults: Sequence[Fault] = (), *, mode: complex, kind: str) -> None:
        super().__init__(message, faults)
        self.mode = mode
        self.kind = kind

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready description, with the mode and the property that fails."""
        return super().to_dict() | {"mode": [self.mode.real, self.mode.imag], "kind": self.kind}


class NoSolutionFound(FlexoptError):
    """A solve did not end in a point that passes the independent checks.

    Attributes:
        violations: constraint name -> size of its violation, in the constraint's unit.
        iterate: the best iterate by variable name, SI.
    """

    def __init__(self, message: str, *, violations: dict[str, float], iterate: dict[str, float]) -> None:
        super().__init__(message)
        self.violations = violations
        self.iterate = iterate

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready description, with the violated constraints and the best iterate."""
        return super().to_dict() | {"violations": self.violations, "iterate": self.iterate}


class WrongSlope(FlexoptError):
    """The derivatives that a solver would climb by disagree with independent ones, so that nothing was solved."""


class MarginNotComputed(NoSolutionFound):
    """ε_max could not be computed to 1e-6: that says nothing about whether a controller stabilises the plant."""


class ExportError(FlexoptError):
    """A graph has no equivalent in C."""


class WriteError(InputError, OSError):
    """A file cannot be written: no room, no permission, no folder. What was there before is as it was.

    Attributes:
        path: of the file.
        size: bytes that it would have.
    """

    def __init__(self, message: str, *, path: str, size: int, code: int | None = None) -> None:
        super().__init__(message)
        self.path = path
        self.size = size
        self.errno = code


class FlexoptWarning(UserWarning):
    """A result is right but needs care: repeated frequencies, a feature that is missing."""


class CompilerNotFound(FlexoptWarning):
    """No C compiler can be used, so CasADi's virtual machine serves: same results, more slowly."""


class ImplausibleMachine(FlexoptWarning):
    """A machine has numbers that are allowed but hardly meant, such as kN for N; `flexopt.check` tells them all."""


def sentence_list(heading: str, faults: Sequence[Fault]) -> str:
    """One message that lists every fault, a line each; of very many the first ones, and how many more there are."""
    if len(faults) == 1:
        return f"{heading}: {faults[0]}"
    lines = [f"  - {fault}" for fault in faults[:FAULTS_SHOWN]]
    if len(faults) > FAULTS_SHOWN:
        lines.append(f"  - and {len(faults) - FAULTS_SHOWN} more")
    return f"{heading} ({len(faults)} faults):\n" + "\n".join(lines)


def raise_if_any(error: type[FlexoptError], heading: str, faults: Sequence[Fault]) -> None:
    """Raise `error` with all `faults` in one message; do nothing when there are none."""
    if faults:
        raise error(sentence_list(heading, faults), faults, heading)
