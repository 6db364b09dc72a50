"""One process that judges inputs by their numbers: `python -m tests.fuzz.worker MATERIAL FOLDER SEED SECONDS`.

It reads a number a line and answers with a line of JSON. Whoever started it watches its time and its memory.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import json
import os
import re
import shutil
import sys
import time
import traceback
import warnings
from pathlib import Path
from random import Random
from typing import Any, TextIO

from tests.fuzz import mutations
from tests.fuzz.ways import KINDS, PLANTED, Command, Input, Kind, Way, in_a_process

# Exit codes of commands: done, bad input, failed, and stopped at a question that nobody answers.
EXIT_CODES = (0, 2, 3, 130)
# What terminals obey.
CONTROL = re.compile(r"\x1b|[\0-\x08\x0e-\x1a]")
# Beside twice what was given, which it may quote.
MESSAGE_MAX = 50_000
# Further names of files; the system takes any but for the slash.
FILE_NAMES = (
    "a b",
    "'",
    '"',
    "a\nb",
    "<script>",
    "\u202ex",
    "ü",
    "a\udcffb",
    "-x",
    "$(id)",
    "%s",
    "x" * 200,
    "\x1b[31m",
)


def kind_of(seed: int, number: int) -> str:
    """Return an input's kind, without making the input."""
    return Random(f"{seed}/{number}").choices(list(KINDS), [kind.share for kind in KINDS.values()])[0]


def make(material: Path, kind: Kind, name: str, rng: Random) -> tuple[Input, str, Way]:
    """Mutated files in the working directory, what is done with them, and its name."""
    ways = kind.shell if kind.shell and (not kind.api or rng.random() < 0.45) else kind.api
    way = rng.choices(list(ways), [weight for weight, _ in ways.values()])[0]
    told = f"{'command' if ways is kind.shell else 'python'} {way}"
    given = Input(rng)
    if not kind.files:
        given.size = 2 * max(map(len, mutations.NAMES))
        return given, told, ways[way][1]
    specimen = rng.choice(sorted((material / name).iterdir()))
    shutil.copytree(specimen, ".", dirs_exist_ok=True)
    files = sorted(path for path in Path().glob(kind.files) if path.is_file())
    path = rng.choice(files)
    given.path = f"./{path}"
    if rng.random() < 0.04:
        told += f" ({mutations.in_place_of(rng, path)})"
    else:
        path.write_bytes(mutations.content_of(rng, path, path.read_bytes()))
        if "*" not in kind.files and rng.random() < 0.05:
            named = path.with_name(rng.choice(FILE_NAMES) + path.suffix)
            with contextlib.suppress(OSError, UnicodeError):
                path.rename(named)
                given.path = f"./{named}"
    given.size = sum(path.stat().st_size for path in files if path.is_file() and not path.is_symlink())
    return given, told, ways[way][1]


def _shown(result: Any) -> None:
    """Make what users look at: the text, and the document as JSON."""
    from flexopt.foundation.documents import json_ready  # noqa: PLC0415

    str(result), repr(result)
    if hasattr(result, "to_dict"):
        json.dumps(json_ready(result.to_dict()), allow_nan=False)


def _judged_command(command: Command, size: int) -> tuple[str, str]:
    words = list(command.words)
    if command.process:
        code, out, err = in_a_process(words)
    else:
        code, out, err = _in_this_process(words)
    line = " ".join(map(repr, words))[:300]
    if "Traceback (most recent call last)" in err or "Traceback (most recent call last)" in out:
        return "traceback", f"{line}\n{err[-2000:]}"
    if code not in EXIT_CODES:
        return "exit code", f"{code} of {line}\n{err[-500:]}"
    if code and not (err + out).strip():
        return "no sentence", line
    if CONTROL.search(out) or CONTROL.search(err):
        return "control", f"{line}\n{(err or out)[-500:]!r}"
    if len(err) > MESSAGE_MAX + 2 * (size + sum(map(len, words))):
        return "long message", f"{len(err)} letters: {line}"
    if "Warning:" in err:
        return "foreign warning", f"{line}\n{err[-500:]}"
    if "--json" in words and out.strip() and words[0] != "completion":
        try:
            json.loads(out, parse_constant=_no_json)
        except ValueError as error:
            return "no JSON", f"{line}: {error}: {out[:200]!r}"
    return ("result" if code == 0 else "refused"), ((err or out).strip() or line)


def _no_json(word: str) -> None:
    raise ValueError(word)


def _in_this_process(words: list[str]) -> tuple[int, str, str]:
    from flexopt.cli import main  # noqa: PLC0415

    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2)]
    code: Any = 0
    with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
        try:
            main(words)
        except SystemExit as leave:
            code = leave.code or 0
    # Held so that both stay open.
    texts = [stream.buffer.getvalue().decode("utf-8", "replace") for stream in streams]  # type: ignore[attr-defined]
    return int(code), texts[0], texts[1]


def judge(given: Input, way: Way) -> tuple[str, str]:
    """Return the verdict on an input in one word, and its sentence or traceback."""
    import flexopt  # noqa: PLC0415

    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            result = way(given)
            if isinstance(result, Command):
                return _judged_command(result, given.size)
            with contextlib.redirect_stdout(io.StringIO()):
                _shown(result)
            found = ("result", "")
        except flexopt.FlexoptError as error:
            message = str(error)
            found = ("refused", message) if message.strip() else ("no sentence", repr(error))
            if len(message) > MESSAGE_MAX + 2 * given.size:
                found = "long message", f"{len(message)} letters: {message[:300]}"
        except BaseException:  # any other is what this looks for
            return "raw error", traceback.format_exc()[-3000:]
    foreign = [str(w.message) + f" ({w.filename}:{w.lineno})" for w in warned if _foreign(w.category)]
    return found if not foreign else ("foreign warning", foreign[0])


def _foreign(category: type[Warning]) -> bool:
    import flexopt  # noqa: PLC0415

    return not issubclass(
        category, flexopt.FlexoptWarning | ResourceWarning | DeprecationWarning | PendingDeprecationWarning
    )


def _reset_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def resident(process: int | str = "self") -> tuple[int, int]:
    """Memory that a process holds, and the most that it held since that was last reset, bytes; 0 where none is told."""
    with contextlib.suppress(OSError):
        text = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace")
        found = {
            line.partition(":")[0]: line.split()[1] for line in text.splitlines() if line.startswith(("VmHWM", "VmRSS"))
        }
        return 1024 * int(found.get("VmRSS", 0)), 1024 * int(found.get("VmHWM", 0))
    return 0, 0


def one(material: Path, seed: int, number: int, planted: str, note: TextIO) -> dict[str, Any]:
    """Make an input in an empty folder and judge it; what is done with it is noted before."""
    rng = Random(f"{seed}/{number}")
    name = rng.choices(list(KINDS), [kind.share for kind in KINDS.values()])[0]
    name = planted or name
    given, told, way = make(material, PLANTED[name] if planted else KINDS[name], name, rng)
    note.write(told + "\n")
    note.flush()
    _reset_peak()
    began = time.monotonic()
    verdict, text = judge(given, way)
    held, peak = resident()
    return {
        "number": number, "kind": name, "way": told, "verdict": verdict, "text": text[:4000],
        "seconds": time.monotonic() - began, "held": held, "peak": peak,
    }  # fmt: skip


def main() -> None:
    """Answer until there are no more numbers."""
    material, folder, seed, seconds = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    numbers = os.fdopen(os.dup(0), encoding="utf-8")
    # Nothing that is printed or asked may end up between the answers.
    quiet = os.open(os.devnull, os.O_RDWR)
    os.dup2(quiet, 0)
    os.dup2(quiet, 1)
    answers.write("ready\n")
    answers.flush()
    stacks = open(f"{folder}.stacks", "w+", encoding="utf-8")  # noqa: SIM115, PTH123  # open as long as this runs
    for line in numbers:
        number, _, planted = line.strip().partition(" ")
        work = Path(folder) / number
        work.mkdir()
        os.chdir(work)
        stacks.seek(0)
        stacks.truncate()
        faulthandler.dump_traceback_later(0.9 * seconds, file=stacks)
        answer = one(material, seed, int(number), planted, stacks)
        faulthandler.cancel_dump_traceback_later()
        os.chdir(material)
        shutil.rmtree(work, ignore_errors=True)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
