"""The FMU of `flexopt export MACHINE --fmu PATH`: its options, and what they do."""

from __future__ import annotations

from typing import Any

from flexopt.cli.common import given, read, tell, together, value, working
from flexopt.cli.judging import real_loop
from flexopt.cli.simulation import TEXTS, loop_options, simulate_arguments, tell_gains
from flexopt.errors import InputError
from flexopt.model import load

LEAD = "With --fmu"
# The options of an FMU but --control and --gain, which `export` has.
fmu_options = together(
    value("--fmu", "PATH", "Write an FMU of the closed loop instead, its reference run beside."),
    value("--fmi", "2.0|3.0", f"{LEAD}: version of FMI (2.0 by default)."),
    value("--kind", "co-simulation|model-exchange", f"{LEAD}: who integrates (co-simulation by default)."),
    # All that `simulate` has but its noise, which comes in through an FMU's inputs.
    loop_options(LEAD, *(name for name in TEXTS if name != "seed")),
)


def write_fmu(machine: str, options: dict[str, Any], as_json: bool) -> None:
    """Write the FMU that `options` (with `control` and `gain`) ask for, and say what was written."""
    from flexopt.export.fmu import export_fmu  # noqa: PLC0415  (only this command needs it)

    loaded, entries = read(load, machine), options.pop("loop")
    asked = simulate_arguments(options)
    if "posture" not in asked and "end_point" not in asked:
        raise InputError("export: an FMU needs --posture or --end-point")
    asked |= given({"version": options["fmi"], "kind": options["kind"]})
    real = real_loop(loaded.loop, entries)
    tell_gains(loaded, real, asked, sampled=asked.get("kind") != "model-exchange")
    with working(options | {"path": options["fmu"], "version": options["fmi"], "loop": entries}, as_json):
        report = export_fmu(loaded, options["fmu"], loop=real, overwrite=options["overwrite"], **asked)
    tell(report, as_json=as_json)
