"""`flexopt study run`, `status` and `export`, and `flexopt sensitivity`."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from multiprocessing import popen_fork
from pathlib import Path
from types import FrameType
from typing import Any

import click

from flexopt.cli.common import (
    ABORTED,
    JSON,
    OUT,
    check_folder,
    check_output,
    given,
    handing_out,
    of_picture,
    print_json,
    ranges_table,
    read,
    say,
    tell,
    value,
    whole,
    working,
    write_output,
)
from flexopt.cli.completing import argument
from flexopt.cli.judging import LOOP, RANGES, real_loop
from flexopt.cli.postures import asked_posture, configuration
from flexopt.cli.terminal import VOICE
from flexopt.model import load

# How often a line of progress comes, s: on a terminal in place of the last one, else below it.
ON_TERMINAL, IN_LOG = 0.2, 30.0
WIDTH = 79


@click.group("study", short_help="The same computation at very many points: run, status, export.")
def study_command() -> None:
    """The same computation at very many points, on all cores or on a cluster, in a folder that nothing is lost from.

    A study file says what varies and what is computed; `flexopt schema study` lists its keys.
    """


@study_command.command("run", short_help="Carry a study out, or go on with it.")
@argument("study")
@value("--out", "DIR", "Folder of the study (the study's name by default); one that holds it already goes on.")
@value("--workers", "N", "Processes (one for each core by default).", whole)
@value("--dask", "ADDRESS", "A Dask scheduler, tcp://HOST:PORT, whose workers see the same folder.")
@JSON
def run_command(as_json: bool, study: str, out: str | None, workers: Any, dask: str | None) -> None:
    """Carry STUDY (a file, or a shipped name) out: every chunk is written as soon as it is computed.

    After Ctrl-C, a kill or a full disk the same command goes on from the chunks that are there.
    """
    from flexopt.large_studies import run_study  # noqa: PLC0415  (only this command needs it)
    from flexopt.model.study_file import load_study  # noqa: PLC0415

    asked = read(load_study, study)
    folder = out or asked.name
    check_folder("--out", folder)
    options = {"workers": workers, "dask": dask}
    try:
        with _interruptible() as check, working(options, as_json), _progress() as progress:

            def told(done: int, total: int) -> None:
                check()
                progress(done, total)

            result = run_study(asked, folder, executor=dask, workers=workers, progress=told)
    except KeyboardInterrupt:
        from flexopt.large_studies import open_study  # noqa: PLC0415

        done = open_study(folder).done if (Path(folder) / "study.json").exists() else 0
        sentence = (
            f"stopped; {done} of {asked.chunks} chunks are in {folder!r}, and the same command goes on from there"
        )
        say(f"flexopt: {sentence}", err=True, colour="red")
        sys.exit(ABORTED)
    tell(result, as_json=as_json)


@study_command.command("status", short_help="How far a study is.")
@argument("folder")
@JSON
def status_command(as_json: bool, folder: str) -> None:
    """How far the study in FOLDER is, at which rate, and what became of its points; also while it runs."""
    from flexopt.large_studies import open_study  # noqa: PLC0415  (only this command needs it)

    tell(open_study(folder), as_json=as_json)


@study_command.command("export", short_help="One file of a whole study.")
@argument("folder")
@value("--out", "FILE.nc|FILE.csv", "The file; required.")
@JSON
def export_command(as_json: bool, folder: str, out: str | None) -> None:
    """Write the study in FOLDER into one netCDF or CSV file; memory does not grow with it."""
    from flexopt.large_studies import open_study  # noqa: PLC0415  (only this command needs it)

    path = out or ""
    check_output("--out", path, (".nc", ".csv"))
    result = open_study(folder)
    write = result.to_csv if path.lower().endswith(".csv") else result.to_netcdf
    write_output("--out", path, lambda: write(path))
    if as_json:
        size = Path(path).stat().st_size
        print_json({"file": path, "bytes": size, "points": result.points, "provenance": result.provenance})
    else:
        say(f"{result.points} points: {path}")


@click.command("sensitivity", short_help="Which unknown matters most.")
@argument("machine")
@configuration
@LOOP
@RANGES
@value("--samples", "N", "Base samples, a power of two (1024 by default).", whole)
@of_picture("Draw it: .png, .svg or .pdf.")
@OUT
@JSON
def sensitivity_command(as_json: bool, machine: str, **options: Any) -> None:
    """Which of what is uncertain matters for every w_i of a posture of MACHINE and for its loop's decay.

    The loop is the file's [loop], or what --loop gives; without either there is no decay.

    The share of the variance that each explains alone and in all, with intervals, and bounds from exact slopes.
    """
    from flexopt.loop.sensitivity import sensitivity  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".json", as_json=as_json)
    loaded = read(load, machine)
    with working(options, as_json):
        ranges, loop = ranges_table(options["ranges"]), real_loop(loaded.loop, options["loop"])
        posture = asked_posture("sensitivity", loaded, options, loop)
        chosen = given(options, "base", "control", "gravity", "samples")
        result = sensitivity(loaded, posture, loop=loop, ranges=ranges, **chosen)
    hand_out(result)


@contextmanager
def _interruptible() -> Generator[Callable[[], None]]:
    """Who is told to end, as by a cluster's scheduler, ends as after Ctrl-C; yields what ends who did not yet.

    Python drops what is raised while it forks, with a traceback: a signal then is told of at the next chunk.
    """
    asked, own = False, os.getpid()

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        if os.getpid() != own:
            # A forked process, before it says what signals are to it: who forked it was told, too, and ends it.
            if number == signal.SIGTERM:
                os._exit(128 + number)
            return
        while frame is not None:
            if frame.f_code.co_filename == popen_fork.__file__:
                return
            frame = frame.f_back
        raise KeyboardInterrupt

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _progress() -> Generator[Callable[[int, int], None]]:
    """Share, rate and time left, on standard error; nothing with --quiet."""
    terminal = sys.stderr.isatty()
    began, first, told = time.monotonic(), -1, 0.0

    def show(done: int, total: int) -> None:
        nonlocal first, told
        now = time.monotonic()
        first = done if first < 0 else first
        if VOICE.quiet or (now - told < (ON_TERMINAL if terminal else IN_LOG) and done < total):
            return
        told, rate = now, (done - first) / max(now - began, 1e-9)
        line = f"{done} of {total} points, {100 * done / total:.1f} %"
        if rate > 0:
            line += f", {rate:.3g} points/s, {(total - done) / rate:.0f} s left"
        click.echo(f"\r{line[:WIDTH]:{WIDTH}}" if terminal else line, err=True, nl=not terminal)

    yield show
    if terminal and told:
        click.echo(err=True)
