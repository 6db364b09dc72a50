"""`flexopt check`."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import click

from flexopt.cli.common import BAD_INPUT, FAILED, JSON, print_json, say, tell, value
from flexopt.cli.completing import argument
from flexopt.errors import Fault, InputError
from flexopt.selection.checking import check


@click.command("check", short_help="Faults of a file, and numbers that are hardly meant; proofs.")
@argument("file")
@value("--machine", "FILE", "With a PROOF.json: the machine that it must be of, a machine or a problem (name or file).")
@JSON
def check_command(as_json: bool, machine: str | None, file: str) -> None:
    """Every fault of FILE, and every number of its machine that is allowed but hardly meant: kN for N, mm for m.

    FILE is a machine, a problem, an experiment or a study (name or file), or a URDF or MJCF file. Ends with 2 where
    there are faults, with 0 where there are only warnings.

    A FILE.json is what `flexopt select --certify --proof` wrote. A program that shares nothing with what wrote it
    computes all of it again (needs flexopt[certificates]). Ends with 0 where it is proven, with 3 where it is not.
    """
    if file.lower().endswith(".json"):
        _check_proof(file, machine, as_json)
        return
    if machine is not None:
        raise InputError("check: --machine goes with a PROOF.json", [Fault("--machine", "goes with a PROOF.json")])
    result = check(file)
    tell(result, as_json=as_json)
    if result.faults:
        sys.exit(BAD_INPUT)


def _check_proof(file: str, machine: str | None, as_json: bool) -> None:
    if find_spec("flint") is None:
        why = "to check a certificate's log needs python-flint: pip install 'flexopt[certificates]'"
        raise InputError(f"check: {why}", [Fault("file", why, file)])
    from flexopt.model import AnyMachine, load_file  # noqa: PLC0415  (only proofs need these)
    from flexopt.selection.certificate import check as checker  # noqa: PLC0415
    from flexopt.selection.certificate.certificate import logged_machine  # noqa: PLC0415

    own = None
    if machine is not None:
        loaded = load_file(machine)
        own = logged_machine(loaded if isinstance(loaded, AnyMachine) else loaded.loaded_machine)["sha256"]
    try:
        log = checker.read(file)
        answer = checker.check(log)
    except checker.Refused as error:
        raise InputError(f"{file}: no log of a certificate: {error}", [Fault("file", str(error), file)]) from None
    told = log["machine"]["sha256"]
    if own not in (None, told):
        answer.faults.append(f"machine: is another than {machine}, whose numbers have the SHA-256 {own}")
    if as_json:
        status = "not proven" if answer.faults else "proven"
        shown = {"upper": log["upper"], "value": answer.value, "scale": answer.scale, "sha256": told}
        print_json({"kind": "certificate", "status": status, "faults": answer.faults, **shown})
    else:
        say(checker.statement(log, answer))
    if answer.faults:
        sys.exit(FAILED)
