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
from flexopt.export.verify.checks import TARGETS, Finding, PlannedCheck, VerificationCheck, VerifyTarget
from flexopt.export.verify.host import host_checks
from flexopt.export.verify.misra import misra_check
from flexopt.export.verify.objects import objects_check
from flexopt.export.verify.target import target_checks
from flexopt.export.verify.tools import PACKAGES, version
from flexopt.foundation.arrays import Document, Progress
from flexopt.foundation.boundary import public, whole, words
from flexopt.foundation.documents import package_version
from flexopt.foundation.rendering import render
from flexopt.foundation.results import Result
from flexopt.foundation.writing import make_folder, write_files

INPUTS, FUZZ_CALLS = 1000, 10_000
COUNT_MAX = 1_000_000
# Position-independent code would put constants with pointers where only the linker writes.
HOST_OBJECT_FLAGS = ("-std=c99", "-O2", "-fno-pic")


@dataclass(frozen=True)
class Verification(Result):
    """What was found.

    Attributes:
        folder: the bundle.
        machine, real, bundle_sha256: what it is.
        targets: what was asked for.
        checks: each finding.
        tools: versions of the programs used.
        manifest: the bundle's.

    Example:
        >>> verification.targets
        ('host',)
    """

    DOCUMENT = """
    passed complete folder machine real bundle_sha256 targets inputs fuzz_calls checks not_verified tools provenance
    """

    folder: Path
    machine: str
    real: str
    bundle_sha256: str
    targets: tuple[VerifyTarget, ...]
    checks: tuple[VerificationCheck, ...]
    tools: dict[str, str]
    inputs: int
    fuzz_calls: int
    manifest: Document = field(repr=False)

    @property
    def provenance(self) -> Document:
        """Of the bundle."""
        return self.manifest["provenance"]

    @property
    def failed(self) -> tuple[VerificationCheck, ...]:
        """Checks that failed."""
        return tuple(check for check in self.checks if check.state == "failed")

    @property
    def not_verified(self) -> tuple[str, ...]:
        """What was not looked at, and which tools are missing."""
        left_out = [f"{target} (not asked for)" for target in TARGETS if target not in self.targets]
        missing = [f"{c.target}: {c.name} ({c.finding})" for c in self.checks if c.state == "not verified"]
        return (*missing, *left_out)

    @property
    def passed(self) -> bool:
        """Whether something was verified and nothing failed."""
        return not self.failed and any(check.state == "passed" for check in self.checks)

    @property
    def complete(self) -> bool:
        """Whether every check of the targets asked for could be made."""
        return all(check.state != "not verified" for check in self.checks)

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
        lines = [f"{marks[c.state]:>7}  {c.target:10}  {c.name}: {c.finding}" for c in self.checks]
        # What tools are missing for stands in the lines.
        left = [f"not verified: {target} (not asked for)" for target in TARGETS if target not in self.targets]
        return "\n".join([*lines, *left, self.sentence])

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


_COUNT = whole(1, COUNT_MAX)


@public("verify", target=words(*TARGETS), inputs=_COUNT, fuzz_calls=_COUNT)
def verify_bundle(
    folder: str | Path,
    *,
    target: VerifyTarget | None = None,
    inputs: int = INPUTS,
    fuzz_calls: int = FUZZ_CALLS,
    progress: Progress | None = None,
) -> Verification:
    """Examine a bundle on this computer and on emulated processors, and write its report.

    The report grows with every check, so that one that is broken off says how far it came. One on other targets stays
    beside it, as `report-TARGET`.

    Args:
        folder: of a bundle from `export_c`.
        target: `"host"`, `"cortex-m4f"` or `"cortex-m7"`; all of them by default.
        inputs: random inputs for each function, compared with Python.
        fuzz_calls: faulty calls for each function.
        progress: called with the number of checks made and of all checks.

    Raises:
        InputError: the folder is no bundle, or an argument is not usable.

    Example:
        >>> report = flexopt.export_c(flexopt.load("excavator"), "bundle", parts=["kinematics"])
        >>> verification = flexopt.verify_bundle("bundle", target="host", inputs=10, fuzz_calls=10)
        >>> verification.passed
        True
    """
    path = Path(folder).resolve()
    if not path.is_dir():
        raise InputError(f"verify: there is no folder {str(folder)!r}")
    manifest = read_manifest(path)
    targets = TARGETS if target is None else (target,)
    with tempfile.TemporaryDirectory(prefix="flexopt-verify-") as scratch:
        bench = Bench(path, Path(scratch), manifest, library_of(manifest), inputs, fuzz_calls)
        planned = [PlannedCheck("files as they were exported", targets[0], lambda: _files(bench))]
        for one in targets:
            planned += _checks(bench, one)
        result = Verification(
            folder=path,
            machine=manifest["machine"]["name"],
            real=manifest["options"]["real"],
            bundle_sha256=manifest["bundle_sha256"],
            targets=targets,
            checks=tuple(check.unmade for check in planned),
            tools={name: version(name) for name in PACKAGES if shutil.which(name)},
            inputs=inputs,
            fuzz_calls=fuzz_calls,
            manifest=manifest,
        )
        _keep_other(result)
        for k, check in enumerate(planned):
            result = replace(result, checks=(*result.checks[:k], check.made(), *result.checks[k + 1 :]))
            result.write()
            if progress is not None:
                progress(k + 1, len(planned))
    return result


def _keep_other(result: Verification) -> None:
    """Put a report on other targets, which the newer one would replace, beside it."""
    try:
        told = json.loads(result.page.with_suffix(".json").read_text(encoding="utf-8"))["targets"]
        others = [target for target in TARGETS if target in told]
        if set(others) <= set(result.targets):
            return
        named = {path.suffix: path.read_bytes() for path in result.page.parent.glob(f"{result.page.stem}.*")}
    except (OSError, ValueError, KeyError, TypeError):
        return
    stem = f"{result.page.stem}-{'-'.join(others)}"
    write_files({result.page.with_name(stem + suffix): content for suffix, content in named.items()})


def _checks(bench: Bench, target: VerifyTarget) -> list[PlannedCheck]:
    if target == "host":
        return [*host_checks(bench), objects_check(bench, "host", "gcc", HOST_OBJECT_FLAGS), misra_check(bench)]
    return target_checks(bench, target)


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
