"""Find a C and C++ compiler, and run it.

In: the environment (`FLEXOPT_CXX`, `FLEXOPT_CC`, `FLEXOPT_COMPILE`), PATH, the `ziglang` package. Out: a `Compiler`, or
none and one message; shared libraries from source text. A compiler serves only after it has built a tiny library that
loads and runs; that this succeeded is remembered in the cache.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import json
import logging
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from flexopt.compiled.storage import digest, recall, remember, scratch
from flexopt.errors import CompilerNotFound
from flexopt.foundation.writing import write_file

_LOG = logging.getLogger(__name__)
_SUFFIX = {"Darwin": ".dylib", "Windows": ".dll"}.get(platform.system(), ".so")
# Strict IEEE: -ffast-math would switch the whole process to flush-to-zero when the library is loaded.
_FLAGS = (
    "-shared", "-fPIC", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast", "-w",
)  # fmt: skip
# Tuned for no processor in particular gcc keeps more of a long straight-line graph in registers: 5 to 10 % faster.
_TARGETS = (("-march=native", "-mtune=generic"), ("-march=native",), ("-mcpu=native",), ())
_WAYS = json.dumps([_FLAGS, _TARGETS])
_OUTPUT_KEPT, _OUTPUT_MAX = 1 << 16, 1 << 24  # bytes
# A compiler that is started for the first time may build its own library before.
_TRIAL_SECONDS = 30.0
_LEAVE_SECONDS = 2.0
_lock, _stopping = threading.Lock(), threading.Event()
_running, _threads = set["subprocess.Popen[bytes]"](), list[threading.Thread]()
_TINY = 'extern "C" __attribute__((visibility("default"))) int flexopt_answer() { return 42; }'


class CompilationFailed(Exception):
    """The compiler refused a source, or took too long.

    Attributes:
        by_source: whether it complained about a place in the source, and so will always.
    """

    def __init__(self, message: str, output: str = "") -> None:
        super().__init__(message)
        self.by_source = re.search(r"source\.c(pp)?:\d+:\d+: (fatal )?error", output) is not None


class CompilerStopped(CompilationFailed):
    """The compiler was stopped: it took too long, or printed without end."""


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C and C++.

    Attributes:
        command: the program and its fixed arguments.
        identity: changes whenever the compiler or the processor does.
        target: flags that choose the processor's instructions.
    """

    command: tuple[str, ...]
    identity: str
    target: tuple[str, ...]

    def build(
        self, source: str, library: Path, *, language: str, level: tuple[str, ...] = ("-O2",), seconds: float = 60.0
    ) -> None:
        """Compile `source` (language "c" or "c++") into the shared library at `library`.

        Raises:
            CompilationFailed: the compiler refused it, failed, or was stopped after `seconds`; there is no room.
        """
        standard = "-std=c++17" if language == "c++" else "-std=c11"
        try:
            with scratch() as folder:
                text = folder / ("source.cpp" if language == "c++" else "source.c")
                write_file(text, source)
                arguments = [*self.command, standard, *level, *_FLAGS, *self.target, "-o", str(library)]
                libraries = [] if platform.system() == "Windows" else ["-lm"]
                _run([*arguments, "-x", language, str(text), *libraries], folder, seconds)
        except OSError as error:
            raise CompilationFailed(f"no room for its files: {error.strerror or error}") from error
        if not library.is_file():
            raise CompilationFailed(f"{self.command[0]} wrote no library")


def library_suffix() -> str:
    """Ending of shared libraries on this system, with its dot."""
    return _SUFFIX


def find_compiler() -> Compiler | None:
    """The compiler in use, or None when there is none that works or `FLEXOPT_COMPILE=0`; tells so once."""
    if os.environ.get("FLEXOPT_COMPILE", "1").strip().lower() in {"0", "off", "no", "false"}:
        _log_once("compilation is switched off by FLEXOPT_COMPILE; CasADi's virtual machine serves")
        return None
    chosen = tuple(os.environ.get(name, "") for name in ("FLEXOPT_CXX", "FLEXOPT_CC"))
    found, reasons = _search(chosen, os.environ.get("PATH", ""))
    if found is None:
        _warn_once(f"no C++ compiler ({reasons}); results are the same, computed more slowly. `pip install ziglang` "
                   "brings a compiler; FLEXOPT_CXX names one")  # fmt: skip
    return found


def in_background(work: Callable[[], object]) -> threading.Thread:
    """A thread that runs a compiler. A process that ends does not wait for it: it ends the compiler."""
    thread = threading.Thread(target=work, name="flexopt compiler", daemon=True)
    with _lock:
        if not _threads:
            atexit.register(_stop)
        _threads.append(thread)
    thread.start()
    return thread


def tell_failure(what: str) -> None:
    """Say once that compilation failed and that the virtual machine serves instead."""
    if not _stopping.is_set():
        _warn_once(f"{what}; results are the same, computed more slowly")


@cache
def _search(chosen: tuple[str, ...], path: str) -> tuple[Compiler | None, str]:
    """The first candidate that works, and why the others do not."""
    reasons: list[str] = []
    try:
        candidates = _candidates(chosen, path)
    except ValueError as error:
        return None, f"{' and '.join(repr(text) for text in chosen if text.strip())} is no command: {error}"
    for command in candidates:
        compiler, reason = _examined(command)
        if compiler is not None:
            _LOG.info("compiling with %s", " ".join(command))
            return compiler, ""
        reasons.append(f"{' '.join(command)}: {reason}")
    return None, "; ".join(reasons) or "none on PATH"


def _candidates(chosen: tuple[str, ...], path: str) -> list[tuple[str, ...]]:
    named = [tuple(shlex.split(text, posix=os.name == "posix")) for text in chosen if text.strip()]
    if named:
        return named
    on_path = [(name,) for name in ("c++", "g++", "clang++") if shutil.which(name, path=path)]
    zig = [(sys.executable, "-m", "ziglang", "cc")] if find_spec("ziglang") else []
    return on_path + zig


def _examined(command: tuple[str, ...]) -> tuple[Compiler | None, str]:
    """The compiler if it builds a library that runs, else the reason."""
    try:
        identity = _identity(command)
    except (OSError, ValueError) as error:
        return None, str(error)
    if identity is None:
        return None, _why_not(command[0])
    known = recall(f"compiler-{digest(identity, _WAYS)}")
    if known is not None:
        return Compiler(command, identity, tuple(json.loads(known))), ""
    reason = ""
    for target in _TARGETS:
        compiler = Compiler(command, identity, target)
        reason, hopeless = _trial(compiler)
        if hopeless:
            break
        if not reason:
            remember(f"compiler-{digest(identity, _WAYS)}", json.dumps(target))
            return compiler, ""
    return None, reason


def _trial(compiler: Compiler) -> tuple[str, bool]:
    """Empty if a tiny library can be built, loaded and called, else why not; whether other options are no use."""
    try:
        with scratch() as folder:
            library = folder / f"tiny{_SUFFIX}"
            compiler.build(_TINY, library, language="c++", seconds=_TRIAL_SECONDS)
            answer = _answer(library)
    except CompilationFailed as error:
        return str(error), isinstance(error, CompilerStopped)
    except OSError as error:
        return f"no room for its files: {error.strerror or error}", True
    return "" if answer == 42 else f"its library answers {answer}", False


def _answer(library: Path) -> object:
    """What the tiny library says; text where it cannot be asked."""
    try:
        return ctypes.CDLL(str(library)).flexopt_answer()
    except (OSError, AttributeError) as error:
        return (str(error).splitlines() or [type(error).__name__])[0]


def _why_not(name: str) -> str:
    """What a name is that is no program."""
    if Path(name).is_dir():
        return "a folder, no program"
    return "not executable" if Path(name).is_file() else "not found"


def _identity(command: tuple[str, ...]) -> str | None:
    """Digest of command, program file and processor, without running anything; None if there is no such program."""
    program = shutil.which(command[0])
    if program is None:
        return None
    file = Path(program).resolve()
    if "ziglang" in command:
        spec = find_spec("ziglang")
        file = Path(spec.origin) if spec and spec.origin else file
    status = file.stat()
    return digest(*command, str(file), str(status.st_size), str(status.st_mtime_ns), _processor())


@cache
def _processor() -> str:
    """The processor's features as far as the system tells them; a cache may be shared between machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        parts = [line for line in lines if line.startswith(("flags", "Features", "model name", "CPU part"))]
        return platform.machine() + "\n".join(sorted(set(parts)))
    except OSError:
        return f"{platform.machine()} {platform.processor()}"


def _run(arguments: list[str], folder: Path, seconds: float) -> None:
    """Run a compiler; where it hangs or prints without end, end it together with the programs it started."""
    # Its own temporary files go where ours go.
    environment = os.environ | {"LC_ALL": "C"} | dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(folder))
    try:
        process = subprocess.Popen(
            arguments, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise CompilationFailed(f"{arguments[0]} cannot be started ({reason})") from error
    said, size = list[bytes](), 0
    # What the compiler started may hold the pipe open when it has ended itself.
    ended = threading.Timer(seconds, _end, (process,))
    ended.daemon = True
    ended.start()
    with _lock:
        _running.add(process)
    if _stopping.is_set():
        _end(process)
    try:
        assert process.stdout is not None
        while part := os.read(process.stdout.fileno(), 1 << 16):
            size += len(part)
            if size <= _OUTPUT_KEPT:
                said.append(part)
            if size > _OUTPUT_MAX:
                raise CompilerStopped(f"{arguments[0]} prints without end")
        process.wait()
        stopped = not ended.is_alive()
    finally:
        ended.cancel()
        with _lock:
            _running.discard(process)
        if process.poll() is None:
            _end(process)
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
    if stopped and process.returncode != 0:
        raise CompilerStopped(f"{arguments[0]} took longer than {seconds:g} s")
    if process.returncode != 0:
        output = b"".join(said).decode(errors="replace")
        first = next((line for line in output.splitlines() if "error" in line), output.strip())
        printable = "".join(c if c.isprintable() else " " for c in first[:200])
        raise CompilationFailed(f"{arguments[0]} ended with {process.returncode}: {printable}", output)


def _stop() -> None:
    """End the compilers in the background, and let their threads remove what they have written."""
    _stopping.set()
    with _lock:
        for process in _running:
            _end(process)
    for thread in _threads:
        thread.join(_LEAVE_SECONDS)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a compiler and what it started."""
    with contextlib.suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)


@cache
def _log_once(message: str) -> None:
    _LOG.info(message)


_warned = False


def _warn_once(message: str) -> None:
    global _warned  # noqa: PLW0603 - one message for each process, whoever asks first
    if not _warned:
        _warned = True
        _LOG.info(message)
        warnings.warn(message, CompilerNotFound, stacklevel=4)
