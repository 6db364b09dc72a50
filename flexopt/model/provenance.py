"""Where a result comes from: machine, versions, options."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Any

from flexopt.model.machine import Machine


def package_version(name: str) -> str:
    """Version of an installed package, `"unknown"` in a source tree that was never installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def provenance(machine: Machine, **options: Any) -> dict[str, Any]:
    """Machine name and content hash, flexopt and CasADi versions, and the options of the call."""
    return {
        "machine": machine.name,
        "machine_sha256": machine.content_hash,
        "flexopt": package_version("flexopt"),
        "casadi": package_version("casadi"),
        "options": options,
    }
