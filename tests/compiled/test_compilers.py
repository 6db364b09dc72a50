"""Which compiler is taken, and what happens when there is none or it fails."""

from __future__ import annotations

import logging
import sys
import warnings
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import accelerate, batch, compilers, find_compiler, recurrence
from flexopt.compiled.compilers import CompilationFailed, Compiler
from flexopt.errors import CompilerNotFound, FlexoptWarning
from tests.compiled.comparison import QUIET


def _function(name: str = "f") -> ca.Function:
    x = ca.SX.sym("x")
    return ca.Function(name, [x], [ca.sin(x) * x])


def _step() -> ca.Function:
    x, e, c = ca.SX.sym("x"), ca.SX.sym("e", 0), ca.SX.sym("c")
    return ca.Function("step", [x, e, c], [ca.sin(c * x), x])


def _check_fallback() -> None:
    points = np.linspace(-3, 3, 20)[None]
    function = _function()
    evaluate = batch(function)
    assert not evaluate.compiled
    np.testing.assert_allclose(evaluate(points)[0], np.sin(points) * points, rtol=1e-14)
    assert accelerate(function) is function
    run = recurrence(_step())
    assert not run.compiled
    np.testing.assert_allclose(run([0.3], [2.0], steps=2).last, [[np.sin(2 * np.sin(0.6))]], rtol=1e-14)


def _script(path: Path, body: str) -> str:
    """A command that runs a Python program as a compiler."""
    path.write_text(body, encoding="utf-8")
    return f'"{sys.executable}" "{path}"' if sys.platform == "win32" else f"'{sys.executable}' '{path}'"


def test_switched_off(empty_cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("FLEXOPT_COMPILE", "0")
    with caplog.at_level(logging.INFO), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert find_compiler() is None
        _check_fallback()
    assert not empty_cache.exists()


def test_none_found_is_told_once(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(empty_cache))
    monkeypatch.setattr("flexopt.compiled.compilers.find_spec", lambda _: None)
    monkeypatch.delenv("FLEXOPT_CXX", raising=False)
    monkeypatch.delenv("FLEXOPT_CC", raising=False)
    with pytest.warns(CompilerNotFound, match="none on PATH.*pip install ziglang") as told:
        _check_fallback()
    assert len(told) == 1, "by several calls"
    assert issubclass(CompilerNotFound, FlexoptWarning)


@pytest.mark.parametrize(
    ("body", "reason"),
    [("import sys; print('error: broken'); sys.exit(3)", "ended with 3: error: broken"), ("", "wrote no library"),
     ("import sys; open(sys.argv[sys.argv.index('-o') + 1], 'w').write('no library')", "")],
)  # fmt: skip
def test_a_compiler_that_fails(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, body: str, reason: str
) -> None:
    monkeypatch.setenv("FLEXOPT_CXX", _script(tmp_path / "cc.py", body))
    with pytest.warns(CompilerNotFound) as told:
        _check_fallback()
    assert find_compiler() is None
    assert len(told) == 1
    assert reason in str(told[0].message)


def test_a_named_compiler_that_does_not_exist(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FLEXOPT_CC", "no-such-compiler-anywhere")
    with pytest.warns(CompilerNotFound, match="no-such-compiler-anywhere: not found"):
        _check_fallback()


ODD = [
    ("'unclosed", "is no command: No closing quotation"),
    ("@folder", "a folder, no program"),
    ("@folder/none", "not found"),
    ("@plain", "not executable" if sys.platform != "win32" else ""),
    ("''", ""),
    ("@garbage -O2 --option='a b'", r"ended with 1: .*\S"),
    ("@endless", "prints without end"),
    ("@hanging", r"took longer than 1 s"),
    ("@leaving", r"took longer than 1 s|wrote no library"),
]
PROGRAMS = {
    "garbage": "import os, sys; os.write(1, bytes(range(256)) * 50); sys.exit(1)",
    "endless": "import os\nwhile True: os.write(1, b'x' * 65536)",
    "hanging": "import time; time.sleep(60)",
    "leaving": "import subprocess, sys; subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])",
}


@pytest.mark.long("@leaving-took longer than 1 s|wrote no library")
@pytest.mark.parametrize(("command", "reason"), ODD)
def test_odd_commands_are_told_and_the_virtual_machine_serves(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str, reason: str
) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "plain").write_bytes(b"")
    name, _, rest = command.removeprefix("@").partition(" ")
    if command.startswith("@"):
        script = _script(tmp_path / f"{name}.py", PROGRAMS[name]) if name in PROGRAMS else f"'{tmp_path / name}'"
        command = f"{script} {rest}"
    monkeypatch.setattr(compilers, "_TRIAL_SECONDS", 1.0)
    monkeypatch.setenv("FLEXOPT_CXX", command)
    with pytest.warns(CompilerNotFound, match=reason) as told:
        _check_fallback()
    assert len(told) == 1
    assert "\n" not in str(told[0].message)


@pytest.mark.filterwarnings(QUIET)
def test_a_command_with_options(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = find_compiler()
    if good is None:
        _check_fallback()
        return
    monkeypatch.setenv("FLEXOPT_CXX", " ".join(f"'{word}'" for word in (*good.command, "-g0", "-DNAME=a b")))
    assert batch(_function()).compiled


@pytest.mark.filterwarnings(QUIET)
def test_a_compiler_that_fails_later(empty_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    good = find_compiler()
    if good is None:
        _check_fallback()
        return
    body = f"""
import subprocess, sys
if "flexopt_answer" not in open(next(a for a in sys.argv if a.endswith((".c", ".cpp")))).read():
    print("fatal: no space left"); sys.exit(1)
sys.exit(subprocess.call({list(good.command)!r} + sys.argv[1:]))
"""
    monkeypatch.setenv("FLEXOPT_CXX", _script(tmp_path / "cc.py", body))
    assert find_compiler() is not None
    with pytest.warns(CompilerNotFound, match="f could not be compiled") as told:
        _check_fallback()
    assert len(told) == 1
    monkeypatch.delenv("FLEXOPT_CXX")
    assert batch(_function()).compiled, "the failure is not remembered"
    assert recurrence(_step()).compiled


def test_a_compiler_that_hangs_is_stopped(tmp_path: Path) -> None:
    script = tmp_path / "cc.py"
    script.write_text("import time; time.sleep(60)", encoding="utf-8")
    compiler = Compiler((sys.executable, str(script)), "test", ())
    with pytest.raises(CompilationFailed, match=r"took longer than 0\.5 s"):
        compiler.build("", tmp_path / "library.so", language="c", seconds=0.5)


@pytest.mark.filterwarnings(QUIET)
def test_a_compiler_is_tried_once_and_then_known(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = find_compiler()
    compilers._search.cache_clear()

    def refuse(_: Compiler) -> tuple[str, bool]:
        raise AssertionError("tried again")

    if found is not None:
        monkeypatch.setattr(compilers, "_trial", refuse)
    assert find_compiler() == found
