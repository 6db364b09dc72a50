"""What a verification found: one `VerificationCheck` each, passed, failed, or not verified."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from flexopt.export.verify.tools import StepFailed, ToolMissing
from flexopt.foundation.arrays import Document
from flexopt.foundation.rendering import OfNumbers
from flexopt.foundation.results import Result

FindingState = Literal["passed", "failed", "not verified"]


@dataclass(frozen=True)
class FindingTable:
    """Numbers behind a finding: a heading, names of columns, and rows of text or numbers."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @property
    def columns(self) -> list[str]:
        """Names of the columns as a page shows them: `OfNumbers` where their values are."""
        numeric = [any(isinstance(row[k], int | float) for row in self.rows) for k in range(len(self.header))]
        return [OfNumbers(name) if each else name for name, each in zip(self.header, numeric, strict=True)]

    @property
    def texts(self) -> list[list[str]]:
        """The rows as a page shows them."""
        return [[_shown(value) for value in row] for row in self.rows]

    def to_dict(self) -> Document:
        """JSON-ready: rows as dictionaries."""
        return {"title": self.title, "rows": [dict(zip(self.header, row, strict=True)) for row in self.rows]}


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.2e}"
    return f"{value:,}" if isinstance(value, int) else str(value)


@dataclass(frozen=True)
class VerificationCheck(Result):
    """One finding.

    Attributes:
        name: what was checked.
        state: `"not verified"` where no compiler was found.
        finding: a sentence.
        tables: the numbers.
    """

    DOCUMENT = "name state finding tables"

    name: str
    state: FindingState
    finding: str
    tables: tuple[FindingTable, ...] = ()


@dataclass
class Finding:
    """What a check's function gives back.

    Attributes:
        sentence: what was found.
        faults: what is wrong; none where the check passed.
        tables: numbers.
    """

    sentence: str
    faults: Sequence[str] = ()
    tables: Sequence[FindingTable] = field(default_factory=tuple[FindingTable, ...])


@dataclass(frozen=True)
class PlannedCheck:
    """What is to be looked at, and how.

    Attributes:
        name: as of `VerificationCheck`.
        look: makes the finding.
    """

    name: str
    look: Callable[[], Finding]

    @property
    def unmade(self) -> VerificationCheck:
        """What is known before: nothing."""
        return VerificationCheck(self.name, "not verified", "broken off before")

    def made(self) -> VerificationCheck:
        """What is found; a missing tool makes it not verified, a program that fails makes it fail."""
        try:
            found = self.look()
        except ToolMissing as error:
            return VerificationCheck(self.name, "not verified", str(error))
        except StepFailed as error:
            return VerificationCheck(self.name, "failed", str(error))
        sentence = found.sentence
        if found.faults:
            more = f" and {len(found.faults) - 8} more" if len(found.faults) > 8 else ""
            sentence = "; ".join(found.faults[:8]) + more
        state = "failed" if found.faults else "passed"
        return VerificationCheck(self.name, state, sentence, tuple(found.tables))
