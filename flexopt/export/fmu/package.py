"""Write an FMU of a machine's closed loop: `export_fmu`."""

from __future__ import annotations

import hashlib
import io
import platform
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack, cast

from flexopt.compiled.accelerated import level_for
from flexopt.compiled.compilers import CompilationFailed, find_compiler, library_suffix
from flexopt.compiled.storage import scratch
from flexopt.errors import CompilerNotFound, ExportError, Fault, InputError, raise_if_any
from flexopt.export.fmu.description import build_description, describe
from flexopt.export.fmu.documents import page, reference_table
from flexopt.export.fmu.interface import KINDS, FmuKind, moving_placement
from flexopt.export.fmu.model import FmuModel
from flexopt.export.fmu.settings import Served
from flexopt.export.fmu.source import VERSIONS, Version, body, source
from flexopt.export.kernels import Unsupported
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, PostureLike
from flexopt.foundation.boundary import path, public, words
from flexopt.foundation.documents import package_version, provenance
from flexopt.foundation.escapes import c_identifier
from flexopt.foundation.results import Result
from flexopt.foundation.warned import warn_user
from flexopt.foundation.writing import write_files
from flexopt.loop.settings import LoopSettings
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop, LoopLike
from flexopt.model.simulation import Sensor, SimulationKeywords, SimulationOptions, placement_of
from flexopt.model.simulation_faults import own_loop
from flexopt.plant.machine_motion import full_structure, motion_of
from flexopt.simulation.real_loop import note_loop, with_loop
from flexopt.simulation.run import simulate_checked
from flexopt.simulation.scenario import SIMULATED, build_scenario, checked_options, given_options, note_options
from flexopt.simulation.trajectory import Trajectory

TOOL = "flexopt"
# What a master would have to draw, or what has no meaning in an FMU.
_NOT_TAKEN = ("seed", "baked")
_SYSTEMS_2 = {"Linux": "linux", "Darwin": "darwin", "Windows": "win"}
_SYSTEMS_3 = {"Linux": "linux", "Darwin": "darwin", "Windows": "windows"}
_PROCESSORS = {"x86_64": "x86_64", "AMD64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
_EPOCH = (1980, 1, 1, 0, 0, 0)  # equal models have equal bytes


@dataclass(frozen=True)
class FmuReport(Result):
    """What was written.

    Attributes:
        path: the FMU.
        reference: the trajectory of `flexopt.simulate` that it reproduces, CSV; inside the FMU, too.
        version, kind: of FMI.
        token: guid (FMI 2) or instantiation token (FMI 3), from the content.
        platforms: for which a library is inside; empty without a compiler.
        period: of a sample, s; co-simulation advances by whole samples.
        parameters, inputs, outputs: names of variables.
        files: inside the FMU.
        warnings: what `flexopt.simulate` warns of in the reference run, and that its loop grows.
        provenance: machine, versions, options.

    Example:
        >>> report.period  # s
        0.005
    """

    path: Path
    reference: Path
    version: Version
    kind: FmuKind
    token: str
    platforms: tuple[str, ...]
    period: float
    parameters: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    files: tuple[str, ...]
    warnings: tuple[str, ...]
    provenance: Document

    def __repr__(self) -> str:
        where = ", ".join(self.platforms) or "sources only"
        lines = [f"FMU {self.version} for {self.kind} of {self.provenance['machine']} in {self.path} ({where})"]
        lines.append(f"  {len(self.parameters)} parameters; inputs: {', '.join(self.inputs)}")
        lines.append(f"  outputs: {', '.join(self.outputs)}")
        lines.append(f"  reference trajectory: {self.reference}")
        return "\n".join([*lines, *(f"  warning: {sentence}" for sentence in self.warnings)])


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    options = given_options(given)
    for name in _NOT_TAKEN:
        if options.pop(name, None) is not None:
            arguments.note(name, "belongs to flexopt.simulate alone", given[name])
    if given["kind"] == "model-exchange" and options.get("hold") is True:
        sentence = "a sampled controller cannot be integrated from outside; take kind = 'co-simulation' or hold = False"
        arguments.note("hold", sentence, True)
    if given["loop"] is not None and given["kind"] == "model-exchange":
        sentence = "is sampled, and goes with kind = 'co-simulation'; with model-exchange give kp and kv"
        arguments.note("loop", sentence, given["loop"])
    else:
        note_loop(arguments, given)
    note_options(arguments, _loop_options(given["kind"], options))


def _loop_options(kind: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of the loop that an FMU of that kind holds."""
    if kind != "model-exchange":
        return dict(options)
    method = options.get("integrator")
    return {**options, "hold": False, "integrator": "dop853" if method is None else method}


@public(
    path=path(".fmu", parent=True),
    version=words(*VERSIONS),
    kind=words(*KINDS),
    together=_together,
    keywords=SIMULATED,
)
def export_fmu(
    machine: AnyMachine,
    path: str | Path,
    posture: PostureLike | None = None,
    *,
    loop: LoopLike | None = None,
    version: Version = "2.0",
    kind: FmuKind = "co-simulation",
    overwrite: bool = False,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SimulationKeywords],
) -> FmuReport:
    """An FMU of the closed loop that `flexopt.simulate` runs, with its parameters exposed.

    Parameters are those of the machine, the posture, the displacement at the start, gains, and what sensors and
    actuators have; inputs are the target and, as far as the base gives in them, x and y of the placement, with their
    rates (and the measurement's errors, where the sensor has noise). Other placement coordinates are parameters. Levers
    and the controller that attains ε_max (`feedback="robust"`) stay those of this machine and posture. Gains of an arm
    of hinges and slides have two units where its Jacobian's inverse is used, as the same f becomes torques and forces;
    FMI cannot tell two, their descriptions do.

    Co-simulation takes whole samples: a communication step shows the last sample that ends within it, and inputs move
    on at their rates through a step. Model exchange gives the derivatives of the continuous loop (`hold=False`).

    Args:
        machine: from `flexopt.load`.
        path: of the FMU, ending in `.fmu`. The reference trajectory goes beside it as `NAME_reference.csv`.
        posture, options, keywords: as `flexopt.simulate` takes them, but seed and baked; a `base_path` and
            `target_path` shape the reference alone, in which the sensor has no noise.
        loop: the real controller, as of `flexopt.simulate`, where the machine's own is the default, too; for
            co-simulation.
        version: of FMI, `"2.0"` or `"3.0"`.
        kind: `"co-simulation"` or `"model-exchange"`.
        overwrite: replace files that are there.

    Raises:
        InputError: arguments are not usable, or a file is there.
        ExportError: the sources do not compile, or a graph cannot be generated.
        SingularPosture, UnreachableTarget, NotStabilizable, NoSolutionFound: as `flexopt.simulate`.

    Warns:
        CompilerNotFound: there is no C compiler, so the FMU holds sources alone.

    Example:
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> report = flexopt.export_fmu(machine, "loop.fmu", posture, kp=1e4, kv=1e3, duration=1.0)
        >>> report.version, report.kind
        ('2.0', 'co-simulation')
    """
    target = Path(path)
    given: dict[str, Any] = {"posture": posture} | keywords
    real = cast("Loop | None", loop) or (own_loop(machine, given) if kind == "co-simulation" else None)
    numbers: LoopSettings | None = None
    served: Served | None = None
    own = machine
    if real is not None:
        machine, given, numbers = with_loop(machine, real, given, "export_fmu")
        if numbers.braking:
            served = Served(numbers, _changed(own, machine))
    checked = checked_options("export_fmu", machine, _loop_options(kind, given))
    _check_base_path(machine, checked)
    reference = target.with_name(f"{target.stem}_reference.csv")
    present = [str(path) for path in (target, reference) if path.exists() and not overwrite]
    sentence = f"would replace {', '.join(present)}; overwrite does"
    raise_if_any(InputError, "export_fmu", [Fault("path", sentence)] if present else [])
    scenario = build_scenario(machine, checked, settings=numbers)
    model = FmuModel(scenario, kind, _quiet(machine, checked, numbers), served)
    try:
        content = body(model)
    except Unsupported as error:
        raise ExportError(f"export_fmu: {error}") from error
    name = c_identifier(machine.name)
    table = reference_table(model)
    files, token = _files(model, version, name, content, table)
    library = _compiled(files["sources/fmu.c"])
    place = _platform(version)
    if library is not None and place is not None:
        files[f"binaries/{place}/{name}{library_suffix()}"] = library
    write_files({target: _zipped(files), reference: table})
    return FmuReport(
        path=target,
        reference=reference,
        version=version,
        kind=kind,
        token=token,
        platforms=(place,) if library is not None and place is not None else (),
        period=model.scenario.period,
        parameters=tuple(variable.name for variable in model.parameters),
        inputs=tuple(variable.name for variable in model.inputs),
        outputs=tuple(variable.name for variable in model.outputs),
        files=tuple(files),
        warnings=_warnings(model.run),
        provenance=provenance(own, version=version, kind=kind, **checked.model_dump(exclude_defaults=True)),
    )


def _changed(machine: AnyMachine, other: AnyMachine) -> dict[str, float]:
    """The machine's own values of the parameters that differ, by name."""
    pairs = zip(machine.parameters, other.parameters, strict=True)
    return {mine.name: mine.value for mine, theirs in pairs if mine.value != theirs.value}


def _check_base_path(machine: AnyMachine, options: SimulationOptions) -> None:
    """Raise where the reference would drive the base along what is no input of the FMU."""
    if options.base_path is None:
        return
    inputs, base = moving_placement(motion_of(full_structure(machine), {})), placement_of(options, machine)
    driven = [
        name
        for k, name in enumerate(machine.base_coordinates)
        if name not in inputs and any(point[k] != base[k] for point in options.base_path.points)
    ]
    sentence = (
        f"drives {' and '.join(driven)}, which the FMU cannot: a base that may be turned must give in both x and y for "
        "them to be inputs"
    )
    raise_if_any(InputError, "export_fmu", [Fault("base_path", sentence)] if driven else [])


def _quiet(machine: AnyMachine, options: SimulationOptions, numbers: LoopSettings | None) -> Trajectory:
    """The run that the FMU reproduces: without the noise, which a master gives."""
    sensor = Sensor(**options.sensor.model_dump(exclude={"noise", "rate_noise"}))
    quiet = options.model_copy(update={"sensor": sensor})
    return simulate_checked(build_scenario(machine, quiet, settings=numbers), numbers)


def _warnings(run: Trajectory) -> tuple[str, ...]:
    """Of the reference run; that it grows, too, which is a result there and no warning."""
    grows = run.verdict == "grows"
    return (*([f"the loop grows: {run.verdict_reason}"] if grows else []), *run.warnings)


def _files(model: FmuModel, version: Version, name: str, content: str, table: str) -> tuple[dict[str, Any], str]:
    """Path -> content of everything but the library, and the token."""
    tool = f"{TOOL} {package_version('flexopt')}"
    title = f"{model.scenario.machine.name}: closed loop, FMI {version}, {model.kind}. Written by {tool}."
    # The identity covers everything that either side reads; both are made with none first.
    plain = source(version, title, content, "", 0) + describe(model, version, name, "", tool)
    digest = hashlib.sha256(plain.encode()).digest()
    token = f"{{{uuid.UUID(bytes=digest[:16])}}}"
    key = int.from_bytes(digest[16:24], "big")
    files: dict[str, Any] = {
        "modelDescription.xml": describe(model, version, name, token, tool),
        "documentation/index.html": page(model, version, tool),
        "resources/reference.csv": table,
        "sources/fmu.c": source(version, title, content, token, key),
    }
    if version == "3.0":
        files["sources/buildDescription.xml"] = build_description(name)
    return files, token


def _compiled(text: str) -> bytes | None:
    """The library, for any processor of this kind; None where there is no compiler."""
    compiler = find_compiler()
    if compiler is None or _platform("3.0") is None:
        sentence = "export_fmu: no C compiler for a library; the FMU holds sources alone, which importers may compile"
        warn_user(sentence, CompilerNotFound)
        return None
    try:
        with scratch() as folder:
            library = folder / f"library{library_suffix()}"
            replace(compiler, target=()).build(text, library, language="c", level=level_for(text) or ("-O1",))
            return library.read_bytes()
    except (CompilationFailed, OSError) as error:
        raise ExportError(f"export_fmu: the sources could not be compiled ({error})") from error


def _platform(version: Version) -> str | None:
    """Folder of this system's libraries."""
    system, processor = platform.system(), _PROCESSORS.get(platform.machine())
    if system not in _SYSTEMS_3 or processor is None:
        return None
    if version == "2.0" and processor == "x86_64":
        return f"{_SYSTEMS_2[system]}64"
    return f"{processor}-{_SYSTEMS_3[system]}"


def _zipped(files: Mapping[str, str | bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    return buffer.getvalue()
