"""Examine a bundle of C, and say what was found.

In: the folder of a bundle. Out: a `Verification`; `report.html` and `report.json` inside the folder.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

from flexopt.errors import InputError
from flexopt.export.bundle import (
    MANIFEST,
    VERIFICATION,
    changed_files,
    library_of,
    read_manifest,
    render_library,
)
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, PlannedCheck, VerificationCheck
from flexopt.export.verify.host import host_checks
from flexopt.export.verify.tools import COMPILERS, version
from flexopt.foundation.arrays import Document, Progress
from flexopt.foundation.boundary import public, whole
from flexopt.foundation.documents import package_version
from flexopt.foundation.rendering import render
from flexopt.foundation.results import Result
from flexopt.foundation.writing import make_folder, write_files

INPUTS, INPUTS_MAX = 1000, 1_000_000


@dataclass(frozen=True)
class Verification(Result):
    """What was found.

    Attributes:
        folder: the bundle.
        machine, real, bundle_sha256: what it is.
        checks: each finding.
        tools: versions of the compilers on this computer.
        inputs: random inputs for each function.
        manifest: the bundle's.

    Example:
        >>> verification.machine
        'excavator'
    """

    DOCUMENT = "passed folder machine real bundle_sha256 inputs checks not_verified tools provenance"

    folder: Path
    machine: str
    real: str
    bundle_sha256: str
    checks: tuple[VerificationCheck, ...]
    tools: dict[str, str]
    inputs: int
    manifest: Document = field(repr=False)

    @property
    def provenance(self) -> Document:
        """Of the bundle."""
        return self.manifest["provenance"]

    @property
    def not_verified(self) -> tuple[str, ...]:
        """Checks that could not be made, and why."""
        return tuple(f"{check.name} ({check.finding})" for check in self.checks if check.state == "not verified")

    @property
    def passed(self) -> bool:
        """Whether every check was made and passed."""
        return all(check.state == "passed" for check in self.checks)

    @property
    def page(self) -> Path:
        """Where the report is, or will be."""
        return self.folder / VERIFICATION / "report.html"

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        counts = {state: sum(c.state == state for c in self.checks) for state in ("passed", "failed", "not verified")}
        return ", ".join(f"{count} checks {state}" for state, count in counts.items() if count)

    def __repr__(self) -> str:
        marks = {"passed": "ok", "failed": "FAILED", "not verified": "none"}
        lines = [f"{marks[check.state]:>7}  {check.name}: {check.finding}" for check in self.checks]
        return "\n".join([*lines, self.sentence])

    def write(self) -> None:
        """Write `report.html` and `report.json` into the bundle's folder `verification`.

        Example:
            >>> verification.write()
        """
        make_folder(self.page.parent)
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        title = f"Verification of {self.machine} ({self.real})"
        page = render("export/templates/verification.html", title=title, result=self, provenance=self.provenance)
        write_files({self.page.with_suffix(".json"): text, self.page: page})


@public("verify", inputs=whole(1, INPUTS_MAX))
def verify_bundle(folder: str | Path, *, inputs: int = INPUTS, progress: Progress | None = None) -> Verification:
    """Build a bundle with this computer's C compiler, run its self-test, compare it with Python, and write a report.

    The report grows with every check, so that one that is broken off says how far it came.

    Args:
        folder: of a bundle from `export_c`.
        inputs: random inputs for each function, compared with Python.
        progress: called with the number of checks made and of all checks.

    Raises:
        InputError: the folder is no bundle, or an argument is not usable.

    Example:
        >>> report = flexopt.export_c(flexopt.load("excavator"), "bundle", parts=["kinematics"])
        >>> verification = flexopt.verify_bundle("bundle", inputs=10)
        >>> verification.passed
        True
    """
    path = Path(folder).resolve()
    if not path.is_dir():
        raise InputError(f"verify: there is no folder {str(folder)!r}")
    manifest = read_manifest(path)
    with tempfile.TemporaryDirectory(prefix="flexopt-verify-") as scratch:
        bench = Bench(path, Path(scratch), manifest, library_of(manifest), inputs)
        planned = [PlannedCheck("files as they were exported", lambda: _files(bench)), *host_checks(bench)]
        result = Verification(
            folder=path,
            machine=manifest["machine"]["name"],
            real=manifest["options"]["real"],
            bundle_sha256=manifest["bundle_sha256"],
            checks=tuple(check.unmade for check in planned),
            tools={name: version(name) for name in COMPILERS if shutil.which(name)},
            inputs=inputs,
            manifest=manifest,
        )
        for k, check in enumerate(planned):
            result = replace(result, checks=(*result.checks[:k], check.made(), *result.checks[k + 1 :]))
            result.write()
            if progress is not None:
                progress(k + 1, len(planned))
    return result


def _files(bench: Bench) -> Finding:
    """Files unchanged, and the same that this flexopt would write."""
    changed = [
        f"{name} was changed after the export, or is missing" for name in changed_files(bench.folder, bench.manifest)
    ]
    options = {name: value for name, value in bench.manifest["options"].items() if name != "parts"}
    texts, _ = render_library(bench.library, options)
    here = {name: package_version(name) for name in ("flexopt", "casadi")}
    there = {name: bench.manifest["provenance"][name] for name in here}
    sentence = f"{len(bench.manifest['files'])} files unchanged"
    if here != there:
        return Finding(f"{sentence}; exported by {there}, compared with {here}", changed)
    kept = {name: bench.folder / name for name in texts if name != MANIFEST}
    different = [name for name, path in kept.items() if not path.is_file() or path.read_bytes() != texts[name].encode()]
    faults = [*changed, *(f"{name} is not what this flexopt writes" for name in different if not changed)]
    return Finding(f"{sentence}, and identical to a fresh export", faults)
