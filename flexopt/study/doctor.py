"""What an installation can do: each check with its finding."""

from __future__ import annotations

import importlib.util
import platform
import shutil
from dataclasses import dataclass

import casadi as ca

from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Document
from flexopt.foundation.documents import package_version, provenance
from flexopt.model import shipped_names
from flexopt.model.files import ShippedKind, read_source
from flexopt.model.reading import load_file
from flexopt.model.study_file import load_study
from flexopt.selection.nlp.solvers import make_solver

COMPILERS = ("cc", "gcc", "clang", "cl")


@dataclass(frozen=True)
class InstallationCheck:
    """One finding. A check that is not `required` only informs."""

    name: str
    passed: bool
    finding: str
    required: bool = True


@dataclass(frozen=True)
class InstallationReport:
    """All findings; healthy when every required check passed."""

    checks: tuple[InstallationCheck, ...]

    @property
    def healthy(self) -> bool:
        """Whether flexopt can do its work here."""
        return all(check.passed for check in self.checks if check.required)

    def to_dict(self) -> Document:
        """JSON-ready dictionary."""
        checks = [vars(check) for check in self.checks]
        return {"healthy": self.healthy, "checks": checks, "provenance": provenance()}

    def __repr__(self) -> str:
        marks = {(True, True): "ok", (True, False): "ok", (False, True): "FAILED", (False, False): "none"}
        lines = [f"{marks[c.passed, c.required]:>7}  {c.name}: {c.finding}" for c in self.checks]
        return "\n".join([*lines, "healthy" if self.healthy else "not healthy: see FAILED above"])


def examine() -> InstallationReport:
    """Run every check."""
    names = (
        "flexopt",
        "casadi",
        "numpy",
        "scipy",
        "matplotlib",
        "xarray",
        "pydantic",
        "click",
        "jinja2",
        "threadpoolctl",
    )
    versions = ", ".join(f"{name} {package_version(name)}" for name in names)
    return InstallationReport(
        (
            InstallationCheck(
                "python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}"
            ),
            InstallationCheck("packages", True, versions),
            _ipopt(),
            _shipped("models"),
            _shipped("problems"),
            _compiler(),
        )
    )


def _ipopt() -> InstallationCheck:
    x = ca.MX.sym("x")
    try:
        quiet = {"print_time": False, "error_on_fail": False, "ipopt": {"print_level": 0, "sb": "yes"}}
        solver = make_solver("doctor", {"x": x, "f": (x - 1) ** 2}, quiet)
        error = abs(float(solver(x0=3.0)["x"]) - 1.0)
    except RuntimeError:
        return InstallationCheck("IPOPT", False, "CasADi was installed without it, or its library cannot be loaded")
    return InstallationCheck(
        "IPOPT", error < 1e-8, "solves a test problem" if error < 1e-8 else f"is off by {error:.1e} on a test"
    )


def _shipped(kind: ShippedKind) -> InstallationCheck:
    names = shipped_names(kind)
    try:
        for name in names:
            (load_study if "compute" in read_source(name, (kind,)).data else load_file)(name)
    except FlexoptError as error:
        return InstallationCheck(kind, False, str(error))
    return InstallationCheck(kind, bool(names), ", ".join(names) or "none found")


def _compiler() -> InstallationCheck:
    found = next((path for name in COMPILERS if (path := shutil.which(name))), None)
    if found is None and importlib.util.find_spec("ziglang"):
        found = "the ziglang package"
    return InstallationCheck(
        "C compiler",
        found is not None,
        f"{found or 'none'} (optional: with one, large maps and simulations are ten to a hundred times faster)",
        required=False,
    )
