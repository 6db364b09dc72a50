"""Examine a bundle of C, and say what was found.

In: the folder of a bundle. Out: a `Verification`; `report.html` and `report.json` inside the folder.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

from flexopt.errors import InputError
from flexopt.export.bundle import (
    MANIFEST,
    VERIFICATION,
    digest_of,
    exported_again,
    read_manifest,
)
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, PlannedCheck, VerificationCheck
from flexopt.export.verify.host import host_checks
from flexopt.export.verify.tools import COMPILERS, version
from flexopt.foundation.arrays import Document, Progress
from flexopt.foundation.boundary import public, whole
from flexopt.foundation.rendering import render
from flexopt.foundation.results import Result
from flexopt.foundation.writing import make_folder, write_files

INPUTS, INPUTS_MAX = 1000, 1_000_000
FILES, VERSIONS = "files as they were exported", ("flexopt", "casadi")


@dataclass(frozen=True)
class Verification(Result):
    """What was found.

    Attributes:
        folder: the bundle.
        machine, real, bundle_sha256: what it is.
        checks: each finding.
        tools: versions of the compilers on this computer.
        inputs: random inputs for each function.
        manifest: of a fresh export.

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
    """Compare a bundle with a fresh export, build that, run its self-test, compare it with Python, and write a report.

    Nothing of the folder is compiled or run. What is built is the fresh export, and only where the bundle's files equal
    it. The report grows with every check, so that one that is broken off says how far it came.

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
        library, texts = exported_again(manifest)
        fresh = json.loads(texts[MANIFEST])
        bench = Bench(Path(scratch) / "bundle", Path(scratch), fresh, library, inputs)
        for name in texts:
            (bench.folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_files({bench.folder / name: text for name, text in texts.items()}, durable=False)
        planned = [PlannedCheck(FILES, lambda: _files(path, manifest, fresh)), *host_checks(bench)]
        result = Verification(
            folder=path,
            machine=fresh["machine"]["name"],
            real=fresh["options"]["real"],
            bundle_sha256=fresh["bundle_sha256"],
            checks=tuple(check.unmade for check in planned),
            tools={name: version(name) for name in COMPILERS if shutil.which(name)},
            inputs=inputs,
            manifest=fresh,
        )
        for k, check in enumerate(planned):
            result = replace(result, checks=(*result.checks[:k], check.made(), *result.checks[k + 1 :]))
            result.write()
            if progress is not None:
                progress(k + 1, len(planned))
            if result.checks[0].state != "passed":
                break
    return result


def _files(folder: Path, manifest: Document, fresh: Document) -> Finding:
    """Files equal to those that this flexopt exports from the bundle's machine and options."""
    here, there = fresh["provenance"], manifest.get("provenance")
    there = cast(Document, there) if isinstance(there, dict) else {}
    if any(here[name] != there.get(name) for name in VERSIONS):
        told = ", ".join(f"{name} {there.get(name)} (here {here[name]})" for name in VERSIONS)
        return Finding("", [f"exported by {told}: export it again to verify it"])
    faults = [] if manifest | {"provenance": fresh["provenance"]} == fresh else [MANIFEST]
    faults += [name for name, digest in fresh["files"].items() if digest_of(folder / name) != digest]
    return Finding(f"{len(fresh['files'])} files equal to a fresh export", [f"{name} differs" for name in faults])
