"""Write a bundle of C for a machine's controller.

In: a machine and which parts are wanted. Out: a folder that compiles and explains itself, and an `ExportReport`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from flexopt.errors import ExportError, Fault, FlexoptWarning, InputError, raise_if_any
from flexopt.export.context import LIMIT_ALLOWANCE_DEG, LIMIT_ALLOWANCE_M, build_context
from flexopt.export.kernels import Real, Unsupported
from flexopt.export.naming import PREFIX_MAX, TAKEN_PREFIXES, prefix_of
from flexopt.export.operations import TOLERANCES, Field
from flexopt.export.parts import LOOP, PARTS
from flexopt.export.project import Project
from flexopt.export.sources import STATUSES, WITH_OUTPUT, Library
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, Document, PostureLike
from flexopt.foundation.boundary import by, number, public, words
from flexopt.foundation.control import Control
from flexopt.foundation.documents import json_ready, provenance
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import several
from flexopt.foundation.reading import read_bounded
from flexopt.foundation.results import Result
from flexopt.foundation.warned import warn_user
from flexopt.foundation.writing import replace_folder
from flexopt.loop.evaluation import outcome
from flexopt.model import AnyMachine, machine_from_dict, tree_from_dict
from flexopt.model.loop import Loop, LoopLike, control_of

FORMAT = "flexopt C bundle"
MANIFEST, MANIFEST_MAX = "manifest.json", 64_000_000
VERIFICATION = "verification"
REALS: tuple[Real, ...] = ("double", "float")
SINGULARITY_MARGIN_DEG = 1.0
# Below this share of accepted inputs an export says so.
FULL = 0.995
# What is told of a loop, from its `Outcome`.
JUDGED = ("decay", "frequency_hz", "allowed_gain", "delay_margin", "disk_margin")
COMPILE_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic")
# What `make` and CMake leave behind when the README is followed.
_PRODUCTS = re.compile(r".*\.(o|a|obj|lib)|\.compiled|selftest(\.exe)?|example(\.exe)?|build/.*|verification/.*")
_REPORT = re.compile(rf"{VERIFICATION}/report\.(html|json)")


@dataclass(frozen=True)
class ExportReport(Result):
    """What was written.

    Attributes:
        folder: where.
        prefix: of every public C name.
        parts: exported parts, with the C functions of each.
        files: paths inside the folder.
        bundle_sha256: identifies the generated code; in the header, too.
        manifest: what manifest.json says.
        left_out: parts that the machine does not allow and nobody asked for, with the reason.

    Example:
        >>> list(report.parts)
        ['kinematics']
    """

    DOCUMENT = "folder prefix parts left_out files bundle_sha256 provenance"

    folder: Path
    prefix: str
    parts: dict[str, tuple[str, ...]]
    files: tuple[str, ...]
    bundle_sha256: str
    manifest: Document = field(repr=False)

    @property
    def provenance(self) -> Document:
        """Machine, versions and options, as manifest.json says them."""
        return self.manifest["provenance"]

    left_out: dict[str, str] = field(default_factory=dict[str, str])

    def __repr__(self) -> str:
        lines = [f"C for {self.manifest['machine']['name']} ({self.manifest['options']['real']}) in {self.folder}"]
        lines += [f"  {part}: {', '.join(names)}" for part, names in self.parts.items()]
        lines += [
            f"  {o['c_name']} accepts {100 * o['acceptance']:.0f} % of random postures inside the limits, not the rest"
            for part in self.manifest["parts"].values()
            for o in part["operations"]
            if o["acceptance"] < FULL
        ]
        lines += [f"  without {part}: {sentence}" for part, sentence in self.left_out.items()]
        judged = self.manifest["options"]["loop"]
        if judged is not None:
            verb = "decays" if judged["decay"] > 0 else "grows"
            lines.append(f"  loop: {judged['controller']}")
            drifts = "; it does not brake the arm's self-motion, loop.nullspace_damping does" * judged["lets_drift"]
            there = f"in the posture {_listed(judged['posture'])}, the weight left out"
            lines.append(f"  it {verb} at {abs(judged['decay']):.4g}/s {there}{drifts}")
        return "\n".join([*lines, f"  {len(self.files)} files; next: make -C {self.folder} test"])


def _listed(values: Sequence[float]) -> str:
    return f"({', '.join(f'{x:.4g}' for x in values)})"


def _check_parts(value: Any) -> tuple[str, ...]:
    given = several(value)
    valid = ", ".join(PARTS)
    unknown = [shown(part) for part in given if not isinstance(part, str) or part not in PARTS]
    if unknown or not given:
        named = f", not {', '.join(unknown[:3])}" if unknown else ""
        raise ValueError(f"must be some of {valid}{named}")
    return tuple(part for part in PARTS if part in given)


def _check_prefix(value: Any) -> str:
    if not isinstance(value, str) or len(value) > PREFIX_MAX or not re.fullmatch(r"[a-z][a-z0-9_]*", value):
        raise ValueError("must be a C name in lower case: a letter, then up to 30 letters, digits or underscores")
    if value in TAKEN_PREFIXES:
        raise ValueError("would make names that C has for other things already; choose another")
    return value


def _allowed(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """Parts that were asked for by name must be possible; a loop needs a posture to be judged in."""
    for part, sentence in _left_out(arguments.of, given["parts"] or ()).items():
        arguments.note("parts", f"{sentence}; {given['machine'].name} does not allow it", part)
    if any(fault.field.split(".")[0] == LOOP for fault in arguments.faults):
        # What is wrong with it is said; what it would go with is not missed.
        return
    if _asked_loop(arguments.of, given["loop"], given["posture"]) is None:
        if LOOP in (given["parts"] or ()):
            arguments.note("parts", _without_loop(None)[LOOP], LOOP)
        for name in ("posture", "base"):
            if given[name] is not None:
                arguments.note(name, "goes with loop only", given[name])
    elif given["posture"] is None and not any(fault.field.startswith("posture") for fault in arguments.faults):
        sentence = "is needed with loop: gains left out follow from it, and its margins are told there"
        arguments.faults.append(Fault("posture", sentence))


def _asked_loop(machine: AnyMachine | None, loop: Any, posture: Any) -> Any:
    """The loop that was given, or with a posture the machine's own."""
    return machine.loop if loop is None and posture is not None and machine is not None else loop


def _left_out(machine: AnyMachine | None, parts: Sequence[str]) -> dict[str, str]:
    """Parts that the machine does not allow, and why."""
    refused = {part: PARTS[part].refusal(machine) for part in parts} if machine is not None else {}
    return {part: sentence for part, sentence in refused.items() if sentence}


def _without_loop(loop: Any) -> dict[str, str]:
    return {LOOP: "it needs a loop and a posture to judge it in"} if loop is None else {}


@public(
    parts=by(_check_parts),
    real=words(*REALS),
    limit_allowance_deg=number("degrees", low=0.0, high=45.0),
    limit_allowance_m=number("m", low=0.0, high=10.0),
    prefix=by(_check_prefix),
    together=_allowed,
)
def export_c(
    machine: AnyMachine,
    folder: str | Path,
    *,
    parts: Sequence[str] | None = None,
    real: Real = "double",
    control: Control | None = None,
    gain: float = 5e5,
    baked: bool = False,
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    limit_allowance_deg: float = LIMIT_ALLOWANCE_DEG,
    limit_allowance_m: float = LIMIT_ALLOWANCE_M,
    prefix: str | None = None,
    overwrite: bool = False,
    loop: LoopLike | None = None,
    posture: PostureLike | None = None,
    base: BaseLike | None = None,
) -> ExportReport:
    """C for the controller of a machine: a folder with one file for each part.

    Its parts are those of `flexopt.export.PARTS`, with their titles. The generated code is that of the CasADi Functions
    which `evaluate` and `select` use, wrapped in functions that check their inputs. Every number of the machine is a
    run-time parameter unless `baked`.

    Args:
        machine: from `flexopt.load`.
        folder: where to write; made if missing. One that exists is replaced, all files in one step where the system
            can do that, if it is an unchanged bundle; what else is in its `build/` stays.
        parts: names from `flexopt.export.PARTS`; by default all that the machine allows.
        real: `"double"`, or `"float"` for single precision throughout.
        control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`: of the measures, the nullspace step and ε_max; by
            default that of `loop`, else of the machine's loop. The controller has both of the first, and the damped
            one if it is this.
        gain: servo gain k_r about which ε_max is tested; the C function takes it as an input.
        baked: whether the machine's parameters become constants: smaller and faster.
        singularity_margin_deg: how far the arm must be from singular postures, degrees; in single precision the parts
            `measures`, `nullspace` and `margin` keep 10 degrees at least.
        limit_allowance_deg, limit_allowance_m: how far measured hinges and slides may lie beyond their limits, degrees
            and m: outputs then come with the warning `BEYOND_LIMIT`, and farther out the call is refused. The defaults
            are above what sensors are calibrated to and end stops give, and below what a broken sensor shows.
        prefix: of every C name; from the machine's name by default, after `machine_` where it alone would make names
            that C or the bundle has already, such as `R_OK`.
        overwrite: replace a bundle that is there.
        loop: the real controller, as of `flexopt.outcome`; the bundle then has the part `loop`, one sample of it with
            its filter, integral and limits, whose numbers are constants, and README.md says what it does. With a
            posture the machine's own `[loop]` is the default.
        posture, base: with a loop: where its margins are told, and from which gains follow that it leaves out.

    Raises:
        InputError: an argument is not usable, or the folder holds something else.
        WriteError: the folder cannot be written; what was there is as it was.
        ExportError: a graph cannot be generated, or a function would refuse almost every input of this machine.

    Example:
        >>> report = flexopt.export_c(flexopt.load("excavator"), "bundle", parts=["kinematics"])
        >>> "README.md" in [str(name) for name in report.files]
        True
    """
    loop = cast("Loop | None", _asked_loop(machine, loop, posture))
    prefix = prefix_of(machine.name) if prefix is None else prefix
    left_out = {} if parts is not None else _left_out(machine, tuple(PARTS)) | _without_loop(loop)
    asked = PARTS if parts is None else parts
    asked = {*asked, LOOP} if loop is not None else set(asked) - {LOOP}
    wanted = tuple(part for part in PARTS if part in asked and part not in left_out)
    judged = None if loop is None else judged_loop(machine, loop, posture, base)
    target = Path(folder)
    check_replaceable(target, overwrite)
    texts, manifest = render_bundle(
        machine,
        wanted,
        real=real,
        control=control_of(control, loop, machine),
        gain=gain,
        baked=baked,
        singularity_margin_deg=singularity_margin_deg,
        limit_allowance_deg=limit_allowance_deg,
        limit_allowance_m=limit_allowance_m,
        prefix=prefix,
        loop=judged,
    )
    replace_folder(target, texts, _kept(target))
    return ExportReport(
        folder=target,
        prefix=prefix,
        parts={part: tuple(o["c_name"] for o in entry["operations"]) for part, entry in manifest["parts"].items()},
        files=tuple(sorted(texts)),
        bundle_sha256=manifest["bundle_sha256"],
        manifest=manifest,
        left_out=left_out,
    )


def judged_loop(machine: AnyMachine, loop: Loop, posture: Any, base: Any) -> dict[str, Any]:
    """A loop's numbers, and what it does in a posture, as a document."""
    found = outcome(machine, posture, base=base, loop=loop)
    if found.decay <= 0:
        warn_user(f"export_c: in this posture the loop grows at {-found.decay:.4g}/s", FlexoptWarning)
    told: dict[str, Any] = {name: json_ready(getattr(found, name)) for name in JUDGED}
    place = [] if base is None else np.ravel(base).tolist()
    told["lets_drift"] = found.settings.lets_drift
    first, source = repr(found.settings).splitlines()[0], found.settings.sources.get("drive", "")
    told["controller"] = f"{first} ({source})" if source else first
    return {"settings": found.settings.to_dict(), "posture": np.ravel(posture).tolist(), "base": place} | told


def build_library(machine: AnyMachine, parts: Sequence[str], *, real: Real, prefix: str, **options: Any) -> Library:
    """The C library of checked options; the others as of `build_context`."""
    context = build_context(machine, single=real == "float", **options)
    try:
        operations = {part: PARTS[part].build(context) for part in PARTS if part in parts}
        library = Library(context, prefix, real, operations)
        _ = library.kernels
    except Unsupported as error:
        raise ExportError(f"export_c: {error}") from error
    return library


def render_bundle(machine: AnyMachine, parts: Sequence[str], **options: Any) -> tuple[dict[str, str], dict[str, Any]]:
    """Path -> text of every file, manifest.json among them, and the manifest; options as of `build_library`."""
    return render_library(build_library(machine, parts, **options), options)


def render_library(library: Library, options: dict[str, Any]) -> tuple[dict[str, str], dict[str, Any]]:
    """The same of a library that was built with these options."""
    bundle_hash = hashlib.sha256(library.kernel_digest_text().encode()).hexdigest()
    texts = library.files(bundle_hash) | Project(library, bundle_hash).files()
    manifest = _manifest(library, bundle_hash, texts, {"parts": list(library.parts)} | options)
    texts[MANIFEST] = json.dumps(manifest, indent=1, allow_nan=False) + "\n"
    return texts, manifest


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a bundle.

    Raises:
        InputError: the folder is no bundle.
    """
    try:
        manifest: Any = json.loads(read_bounded(folder / MANIFEST, MANIFEST_MAX))
        good = manifest["format"] == FORMAT and all(manifest["files"].values()) and manifest["options"]["prefix"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError, AttributeError):
        manifest, good = None, False
    if not good:
        sentence = "is no bundle written by flexopt export: it has no manifest.json of one"
        raise_if_any(InputError, "verify", [Fault("folder", sentence, repr(str(folder)))])
    return cast(dict[str, Any], manifest)


def library_of(manifest: dict[str, Any]) -> Library:
    """The library that a manifest describes, built again from the machine inside it."""
    options = dict(manifest["options"])
    parts = options.pop("parts")
    return build_library(machine_of(manifest), parts, **options)


def exported_again(manifest: dict[str, Any]) -> tuple[Library, dict[str, str]]:
    """The library and the files of a fresh export of what a manifest describes.

    Raises:
        InputError: the manifest describes no export.
    """
    try:
        library = library_of(manifest)
        options = {name: value for name, value in manifest["options"].items() if name != "parts"}
        return library, render_library(library, options)[0]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        sentence = f"its manifest.json describes no export ({type(error).__name__}: {error})"
        raise_if_any(InputError, "verify", [Fault("folder", sentence)])
        raise


def machine_of(manifest: dict[str, Any]) -> AnyMachine:
    """The machine inside a manifest, planar or spatial."""
    data = manifest["machine"]
    return tree_from_dict(data) if "bodies" in data else machine_from_dict(data)


def changed_files(folder: Path, manifest: dict[str, Any]) -> list[str]:
    """Files of the bundle that are missing or not as they were written."""
    return [name for name, digest in manifest["files"].items() if digest_of(folder / name) != digest]


def digest_of(path: Path) -> str:
    """SHA-256 of a file; empty where there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _manifest(library: Library, bundle_hash: str, texts: dict[str, str], options: dict[str, Any]) -> dict[str, Any]:
    machine, parameters = library.context.machine, library.context.parameters

    def described(f: Field, *, is_input: bool) -> dict[str, Any]:
        about: dict[str, Any] = {"name": f.name, "shape": list(f.shape), "unit": f.unit, "text": f.text}
        if not is_input:
            return about | {"scale": f.scale}
        about |= {"low": list(f.low), "high": list(f.high)}
        about |= {} if f.design is None else {"limits": [list(side) for side in f.design]}
        return about | ({"turning": list(f.turning)} if f.turns else {})

    parts = {
        part: {
            "title": PARTS[part].title,
            "source": f"src/{library.prefix}_{part}.c",
            "operations": [
                {
                    "name": o.name,
                    "c_name": f"{library.prefix}_{o.name}",
                    "text": o.text,
                    "inputs": [described(f, is_input=True) for f in o.inputs],
                    "outputs": [described(f, is_input=False) for f in o.outputs],
                    "guards": [vars(g) for g in o.guards],
                    "workspace_reals": library.workspace(o),
                    "acceptance": library.acceptance[o.name],
                }
                for o in group
            ],
        }
        for part, group in library.operations.items()
    }
    listed = [] if library.baked else list(
        zip(parameters.names, parameters.units, parameters.values, parameters.low, parameters.high, strict=True)
    )  # fmt: skip
    return {
        "format": FORMAT,
        "format_version": 1,
        "prefix": library.prefix,
        "bundle_sha256": bundle_hash,
        "machine_sha256": machine.content_hash,
        "machine": {key: value for key, value in machine.to_dict().items() if key != "visuals"},
        "options": options,
        "tolerance": TOLERANCES[library.real],
        "sizes": library.sizes,
        "statuses": {name: k for k, name in enumerate(STATUSES)},
        "statuses_with_output": list(WITH_OUTPUT),
        "limit_allowance": library.context.limit_allowance,
        "parts": parts,
        "left_out": _left_out(machine, tuple(PARTS)) | _without_loop(library.context.judged_loop),
        "parameters": [dict(zip(("name", "unit", "value", "low", "high"), row, strict=True)) for row in listed],
        "compile_flags": list(COMPILE_FLAGS),
        "libraries": ["m"],
        "files": {name: hashlib.sha256(text.encode()).hexdigest() for name, text in sorted(texts.items())},
        "provenance": provenance(machine, **options),
    }


def check_replaceable(folder: Path, overwrite: bool) -> None:
    """Raise unless the folder is missing, empty, or a bundle nothing in which would be lost."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    sentence = ""
    if not folder.is_dir():
        sentence = "is a file"
    elif not overwrite:
        sentence = "holds files; overwrite replaces a bundle"
    elif not (folder / MANIFEST).is_file():
        sentence = "holds something else than a bundle of flexopt; choose another folder"
    else:
        manifest = read_manifest(folder)
        present = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir()}
        foreign = sorted(p for p in present - set(manifest["files"]) - {MANIFEST} if not _PRODUCTS.fullmatch(p))
        if foreign:
            sentence = f"holds files that are not the bundle's: {_some(foreign)}; move them, or choose another folder"
    raise_if_any(InputError, "export_c", [Fault("folder", sentence, repr(str(folder)))] if sentence else [])


def _kept(folder: Path) -> Callable[[str], bool]:
    """Which files of an older bundle stay when another takes its place: all but its own and what `make` made of them.

    `build/` may hold a user's own files. A report on the older code says nothing of the newer one.
    """
    gone = {".compiled", "selftest", "selftest.exe", "example", "example.exe"}
    if (folder / MANIFEST).is_file():
        manifest = read_manifest(folder)
        gone |= {str(Path(name).with_suffix(".o").as_posix()) for name in manifest["files"] if name.endswith(".c")}
        gone.add(f"lib{manifest['options']['prefix']}_control.a")
    return lambda name: bool(_PRODUCTS.fullmatch(name)) and not _REPORT.fullmatch(name) and name not in gone


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
