"""The errors that flexopt raises, and how their sentences are put together.

In: faults found anywhere in the package. Out: one exception tree under `FlexoptError`; every message names the
field, the value, its unit and what is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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

    Example:
        >>> try:
        ...     flexopt.evaluate(flexopt.load("excavator"), (0.9, -2.6), gain=-1)
        ... except flexopt.FlexoptError as error:
        ...     print(error)
        evaluate: gain = -1: must be greater than 0 and at most 1e+15
    """

    def __init__(self, message: str, faults: Sequence[Fault] = (), heading: str = "") -> None:
        super().__init__(message)
        self.faults = tuple(faults)
        self.heading = heading

    def to_dict(self) -> dict[str, object]:
        """JSON-ready description of the error.

        Example:
            >>> try:
            ...     flexopt.load("excavater")
            ... except flexopt.FlexoptError as error:
            ...     print(error.to_dict()["type"])
            ModelError
        """
        return {
            "type": type(self).__name__,
            "message": str(self),
            "faults": [{"field": f.field, "value": f.value, "sentence": f.sentence} for f in self.faults],
        }


class InputError(FlexoptError, ValueError):
    """An argument or option is not usable: wrong shape, not finite, out of its range, unknown word.

    Example:
        >>> try:
        ...     flexopt.evaluate(flexopt.load("excavator"), (0.9,))
        ... except flexopt.InputError as error:
        ...     print(error)
        evaluate: posture = (0.9,): needs 2 angles in rad, one for each actuated joint (boom, stick), not 1
    """


class ModelError(InputError):
    """A machine or problem file (or the dictionary in its place) is not usable.

    Example:
        >>> try:
        ...     flexopt.machine_from_dict({"name": "m", "base": {"mass": -1.0}})
        ... except flexopt.ModelError as error:
        ...     print(len(error.faults), error.faults[0])
        6 base.length: is required and missing
    """


class UnreachableTarget(InputError):
    """No posture puts the end-point on the target.

    Attributes:
        miss: how far outside the reach the target lies, m.
        base_intervals: intervals of the placement coordinate that would bring it within reach, m.

    Example:
        >>> try:
        ...     flexopt.inverse_kinematics(flexopt.load("excavator"), (9.0, 1.6), base=0.0)
        ... except flexopt.UnreachableTarget as error:
        ...     print(f"{error.miss:.2f} m")
        5.88 m
    """

    def __init__(self, message: str, *, miss: float, base_intervals: Sequence[tuple[float, float]] = ()) -> None:
        super().__init__(message)
        self.miss = miss
        self.base_intervals = tuple(base_intervals)

    def to_dict(self) -> dict[str, object]:
        """JSON-ready description, with the miss and the placements that would do.

        Example:
            >>> try:
            ...     flexopt.inverse_kinematics(flexopt.load("excavator"), (9.0, 1.6), base=0.0)
            ... except flexopt.UnreachableTarget as error:
            ...     print(sorted(error.to_dict()))
            ['base_intervals', 'faults', 'message', 'miss', 'type']
        """
        intervals = [list(interval) for interval in self.base_intervals]
        return super().to_dict() | {"miss": self.miss, "base_intervals": intervals}


class SingularPosture(InputError):
    """The rigid-body Jacobian loses rank, so the end-point cannot be driven in every direction.

    Attributes:
        joint: the joint that would lead out of the singularity fastest.
        angle: its value, rad (of a slide m).

    Example:
        >>> try:
        ...     flexopt.evaluate(flexopt.load("excavator"), (0.9, 0.0))
        ... except flexopt.SingularPosture as error:
        ...     print(error.joint)
        stick
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

    Example:
        >>> try:
        ...     flexopt.robust_margin([[1.0]], [[0.0]], [[1.0]])  # grows, and no input reaches it
        ... except flexopt.NotStabilizable as error:
        ...     print(error.mode, error.kind)
        (1+0j) stabilizable
    """

    def __init__(self, message: str, faults: Sequence[Fault] = (), *, mode: complex, kind: str) -> None:
        super().__init__(message, faults)
        self.mode = mode
        self.kind = kind

    def to_dict(self) -> dict[str, object]:
        """JSON-ready description, with the mode and the property that fails.

        Example:
            >>> try:
            ...     flexopt.robust_margin([[1.0]], [[1.0]], [[0.0]])
            ... except flexopt.NotStabilizable as error:
            ...     print(error.to_dict()["kind"])
            detectable
        """
        return super().to_dict() | {"mode": [self.mode.real, self.mode.imag], "kind": self.kind}


class NoSolutionFound(FlexoptError):
    """A solve did not end in a point that passes the independent checks.

    Attributes:
        violations: constraint name -> size of its violation, in the constraint's unit.
        iterate: the best iterate by variable name, SI.

    Example:
        >>> error = flexopt.NoSolutionFound("no solve converged", violations={"target": 0.1}, iterate={"base.x": 2.0})
        >>> error.violations
        {'target': 0.1}
    """

    def __init__(self, message: str, *, violations: dict[str, float], iterate: dict[str, float]) -> None:
        super().__init__(message)
        self.violations = violations
        self.iterate = iterate

    def to_dict(self) -> dict[str, object]:
        """JSON-ready description, with the violated constraints and the best iterate.

        Example:
            >>> error.to_dict()["iterate"]
            {'base.x': 2.0}
        """
        return super().to_dict() | {"violations": self.violations, "iterate": self.iterate}


class WrongSlope(FlexoptError):
    """The derivatives that a solver would climb by disagree with independent ones, so that nothing was solved.

    Example:
        >>> issubclass(flexopt.WrongSlope, flexopt.FlexoptError)
        True
    """


class MarginNotComputed(NoSolutionFound):
    """ε_max could not be computed to 1e-6: that says nothing about whether a controller stabilises the plant.

    Example:
        >>> issubclass(flexopt.MarginNotComputed, flexopt.NoSolutionFound)
        True
    """


class ExportError(FlexoptError):
    """A graph has no equivalent in C, or in JavaScript.

    Example:
        >>> try:
        ...     flexopt.export_c(flexopt.load("excavator"), "bundle", parts=["levers"])
        ... except flexopt.FlexoptError as error:
        ...     print(error)
        export_c: parts = 'levers': the levers of boom, stick need a cylinder or a speed; excavator does not allow it
    """


class StudyInterrupted(FlexoptError):
    """A study ended before its last chunk: its disk is full, its workers or their scheduler are gone.

    Nothing that was finished is lost: the same call goes on where this one ended.

    Attributes:
        folder: of the study.
        done, chunks: chunks that are finished, and all.

    Example:
        >>> issubclass(flexopt.StudyInterrupted, flexopt.FlexoptError)
        True
    """

    def __init__(self, message: str, *, folder: str, done: int, chunks: int) -> None:
        super().__init__(message)
        self.folder, self.done, self.chunks = folder, done, chunks

    def to_dict(self) -> dict[str, object]:
        """JSON-ready description, with how far the study came.

        Example:
            >>> flexopt.StudyInterrupted("stopped", folder="study", done=3, chunks=8).to_dict()["done"]
            3
        """
        return super().to_dict() | {"folder": self.folder, "done": self.done, "chunks": self.chunks}


class WriteError(InputError, OSError):
    """A file cannot be written: no room, no permission, no folder. What was there before is as it was.

    Attributes:
        path: of the file.
        size: bytes that it would have.

    Example:
        >>> try:
        ...     flexopt.simulate(flexopt.load("excavator"), (0.9, -2.6), duration=0.1).to_csv("none/run.csv")
        ... except flexopt.WriteError as error:
        ...     print(error.path)
        none/run.csv
    """

    def __init__(self, message: str, *, path: str, size: int, code: int | None = None) -> None:
        super().__init__(message)
        self.path = path
        self.size = size
        self.errno = code


class FlexoptWarning(UserWarning):
    """A result is right but needs care: repeated frequencies, a feature that is missing.

    Attributes:
        remarks: every sentence, where the message is a summary of several; else the message alone.

    Example:
        >>> import warnings
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("error", flexopt.FlexoptWarning)  # to stop at what needs care
        ...     machine = flexopt.load("excavator")
    """

    def __init__(self, message: str, remarks: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.remarks = remarks or (message,)


class CompilerNotFound(FlexoptWarning):
    """No C compiler can be used, so CasADi's virtual machine serves: same results, more slowly.

    Example:
        >>> import warnings
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("error", flexopt.CompilerNotFound)  # to stop where one is expected
        ...     machine = flexopt.load("excavator")
    """


class ImplausibleMachine(FlexoptWarning):
    """A machine has numbers that are allowed but hardly meant, such as kN for N; `flexopt.check` tells them all.

    Example:
        >>> data = flexopt.load("excavator").to_dict()
        >>> data["base"]["mass"] = 5.2915  # t, where kg are meant
        >>> [finding.field for finding in flexopt.check(flexopt.machine_from_dict(data)).findings][:1]
        ['base.inertia']
    """


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
