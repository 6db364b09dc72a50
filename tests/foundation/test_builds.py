"""The build that provenance names: another one for any change of the package, the same wherever it is installed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import flexopt
from flexopt.foundation.documents import build_version

PACKAGE = Path(flexopt.__file__).parent


def version_of(folder: Path) -> str:
    """What a process says that imports the package from there."""
    told = "from flexopt.foundation.documents import build_version as b; print(b())"
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r}); {told}"]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True).stdout.strip()


def test_a_build_is_known_by_all_of_the_package(tmp_path: Path) -> None:
    copy = tmp_path / "flexopt"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "models", "problems"))
    assert version_of(tmp_path) == build_version()
    # As a wheel has it: machines beside the modules, and lines that end as on Windows.
    (copy / "models").mkdir()
    (copy / "models" / "excavator.toml").write_text("schema = 1\n")
    (copy / "errors.py").write_bytes((copy / "errors.py").read_bytes().replace(b"\n", b"\r\n"))
    assert version_of(tmp_path) == build_version()
    with (copy / "foundation" / "rounding.py").open("a") as file:
        file.write("# changed\n")
    assert version_of(tmp_path) != build_version()


def test_provenance_names_the_build() -> None:
    assert flexopt.evaluate(flexopt.load("excavator"), (0.9929, -2.6306)).provenance["flexopt"] == build_version()
    assert build_version().startswith(f"{flexopt.__version__}+")
