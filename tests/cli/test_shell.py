"""The command as a shell and a terminal see it: completion, examples, quiet and verbose, colours, width, Ctrl-C."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

import flexopt
from flexopt.cli import common, main
from flexopt.cli.commands import COMMANDS, cli
from flexopt.cli.common import clock, progress_bar
from flexopt.cli.completing import SHELLS
from flexopt.cli.examples import EXAMPLES
from flexopt.cli.shell import VARIABLE
from flexopt.cli.terminal import VOICE, folded
from flexopt.model import shipped_names
from tests.cli.command import Command

ROOT = Path(__file__).parents[2]
# Without their effects on files, these are done in a second.
QUICK = {"check", "completion", "doctor", "evaluate", "explain"}
COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Terminal(io.StringIO):
    """A stream that says it is one."""

    def isatty(self) -> bool:
        return True


def completions(*words: str) -> list[str]:
    """What the shell is offered for the last of the words."""
    *before, last = words
    return [item.value for item in ShellComplete(cli, {}, "flexopt", VARIABLE).get_completions(before, last)]


def kinds(*words: str) -> set[str]:
    *before, last = words
    return {item.type for item in ShellComplete(cli, {}, "flexopt", VARIABLE).get_completions(before, last)}


def test_commands_machines_and_problems_are_completed() -> None:
    assert completions("e") == ["evaluate", "explain", "explore", "export"]
    assert completions("evaluate", "") == shipped_names("models")
    assert completions("verdict", "art") == [name for name in shipped_names("problems") if name.startswith("art")]
    assert set(completions("select", "")) == {*shipped_names("models"), *shipped_names("problems")}
    assert kinds("evaluate", "./mine") == {"file"}
    assert kinds("verify", "") == {"dir"}
    assert kinds("identify", "excavator", "sw") == {"file"}
    assert completions("completion", "") == list(SHELLS)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("evaluate", "excavator", "--control", ""), ["inverse", "transpose", "damped:"]),
        (("evaluate", "excavator", "--elbow", "d"), ["down"]),
        (("select", "excavator", "--objective", "w"), ["w1", "w2", "w3"]),
        (("select", "slewing-excavator", "--objective", "w"), [f"w{k}" for k in range(1, 7)]),
        (("select", "article", "--objective", "w1,ep"), ["w1,epsilon_max"]),
        (("select", "excavator", "--assume", "ground,l"), ["ground,limits"]),
        (("evaluate", "excavator", "--loop", "de"), ["default", "dead_time="]),
        (("evaluate", "excavator", "--loop", "k"), ["kp=", "kv=", "ki=", "kp_range=", "kv_range="]),
        (("region", "excavator", "--ranges", "payload"), ["payload.mass="]),
        (("map", "excavator", "--vary", "k"), ["kp=", "kv=", "ki="]),
        (("map", "excavator", "--vary", "stif"), ["stiffness="]),
        (("map", "excavator", "--vary", "r"), []),
        (("map", "boom-stick-bucket", "--joints", "b"), ["boom", "bucket"]),
        (("map", "excavator", "--over", ""), ["end_point", "posture", "base"]),
        (("export", "excavator", "--real", ""), ["double", "float"]),
        (("map", "nothing", "--joints", ""), []),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_values_are_completed(words: tuple[str, ...], expected: list[str]) -> None:
    assert completions(*words) == expected


def test_every_word_of_a_choice_is_taken_by_its_command(command: Command) -> None:
    for control in completions("evaluate", "excavator", "--control", "")[:2]:
        assert command("evaluate", "excavator", "--posture", "1,-2", "--control", control).code == 0


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_a_shell(command: Command, shell: str) -> None:
    script = command("completion", shell).stdout
    assert f"{VARIABLE}={shell}_complete" in script
    assert command.json("completion", shell)["script"] + "\n" == script
    assert command("completion", "tcsh").code == 2


def test_what_the_script_calls_answers() -> None:
    asked = {"COMP_WORDS": "flexopt evaluate exc", "COMP_CWORD": "2", VARIABLE: "bash_complete"}
    done = subprocess.run(
        [sys.executable, "-c", "from flexopt.cli import main; main()"],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | asked, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.stdout == "plain,excavator\n", done.stderr


@pytest.mark.long
def test_every_command_has_examples_and_every_example_is_understood(command: Command) -> None:
    assert set(EXAMPLES) == {"", *COMMANDS}
    for name, lines in EXAMPLES.items():
        told = command(*([name] if name else []), "--help").stdout
        assert not re.search(r" --[\w-]+ \\\n +[^- ]", told)
        told = re.sub(r" \\\n +", " ", told)
        assert "Examples:" in told
        for line in lines:
            assert line in told
            words = shlex.split(re.sub(r'^eval "\$\((.*)\)"$', r"\1", line))
            assert words[0] == "flexopt"
            found = cli.get_command(click.Context(cli), words[1])
            assert found is not None
            assert not name or words[1] == name
            found.make_context(words[1], words[2:])
            if words[1] in QUICK:
                assert command(*words[1:]).code == 0, line


@pytest.mark.long
def test_python_runs_the_command_as_a_module() -> None:
    asked = ["--version"], ["evaluate", "excavator", "--posture", "a,b", "--json"]
    for arguments in asked:
        script, module = (
            subprocess.run([sys.executable, *way, *arguments], capture_output=True, text=True, check=False)
            for way in (["-c", "from flexopt.cli import main; main()"], ["-m", "flexopt"])
        )
        assert (module.returncode, module.stdout, module.stderr) == (script.returncode, script.stdout, script.stderr)
        assert module.stdout


def test_options_that_examples_name_are_there() -> None:
    """The check above sees a mistake."""
    found = cli.get_command(click.Context(cli), "evaluate")
    assert found is not None
    with pytest.raises(click.UsageError):
        found.make_context("evaluate", ["excavator", "--postures", "1,2"])


def test_quiet_leaves_results_and_errors(command: Command) -> None:
    asked = ("select", "excavator", "--end-point", "0,1.6", "--starts", "1")
    loud, quiet = command(*asked), command("-q", *asked)
    assert "starts" in loud.stderr
    assert quiet.stderr == ""
    assert quiet.stdout == loud.stdout
    data = (ROOT / "models" / "excavator.toml").read_text(encoding="utf-8").replace("5291.5", "5.2915")
    command.write("light.toml", data)
    light = ("evaluate", "light.toml", "--posture", "1,-2")
    assert "warning" in command(*light).stderr
    assert command("--quiet", *light).stderr == ""
    assert "no machine" in command("-q", "evaluate", "nothing", "--posture", "1,-2").stderr


def test_verbose_tells_versions_time_and_where_errors_arose(command: Command) -> None:
    good = command("-v", "check", "excavator")
    assert good.stdout == command("check", "excavator").stdout
    assert re.fullmatch(r"flexopt: \d+\.\d\d s; flexopt \S+, casadi \S+, numpy \S+, Python \S+\n", good.stderr)
    bad = command("--verbose", "evaluate", "nothing", "--posture", "1,-2")
    assert bad.code == 2
    assert "Traceback" in bad.stderr
    assert "Traceback" not in command("evaluate", "nothing", "--posture", "1,-2").stderr
    assert command("-q", "-v", "check", "excavator").code == 2


def fails_on_a_terminal(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    stream = Terminal()
    with monkeypatch.context() as inside:
        inside.setattr("sys.stderr", stream)
        with pytest.raises(SystemExit):
            main([*arguments, "evaluate", "nothing", "--posture", "1,-2"])
    return stream.getvalue()


def test_colours_are_for_terminals_and_can_be_switched_off(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    coloured = fails_on_a_terminal(monkeypatch)
    assert coloured.startswith("\x1b[31mflexopt: ")
    plain = COLOUR.sub("", coloured)
    assert fails_on_a_terminal(monkeypatch, "--no-color") == plain
    monkeypatch.setenv("NO_COLOR", "1")
    assert fails_on_a_terminal(monkeypatch) == plain
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert fails_on_a_terminal(monkeypatch) == plain
    monkeypatch.setenv("TERM", "xterm")
    # A pipe has none.
    assert not COLOUR.search(command("evaluate", "nothing", "--posture", "1,-2").stderr)
    assert VOICE.colour


def test_a_clock_runs_where_nothing_else_tells_that_work_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not with --quiet, not beside a bar; on a terminal the line is cleared at its end, a log hears of it seldom."""
    context = click.Context(
        click.Command("simulate"), info_name="simulate", parent=click.Context(cli, info_name="flexopt")
    )

    def told(stream: io.StringIO, expected: str, *, bar: bool = False) -> str:
        """What is told until the expected text is."""
        live, never = stream.isatty(), 3600.0
        with monkeypatch.context() as inside, context:
            inside.setattr("sys.stderr", stream)
            inside.setattr("flexopt.cli.common.TICK", 0.01 if live else never)
            inside.setattr("flexopt.cli.common.SELDOM", never if live else 0.01)
            with clock(), progress_bar("starts") if bar else contextlib.nullcontext():
                for _ in range(6000):
                    if expected in stream.getvalue():
                        break
                    time.sleep(0.01)
        return stream.getvalue()

    seen = told(Terminal(), "simulate: 2 s")
    assert seen.startswith("\rsimulate: 1 s\rsimulate: 2 s")
    assert seen.endswith("\r")
    assert not seen.split("\r")[-2].strip()
    lines = told(io.StringIO(), "s\n").splitlines()
    assert lines
    assert all(re.fullmatch(r"simulate: \d+ s", line) for line in lines)
    # Beside a bar it is the bar's own seconds; a log hears what is counted, and for how long.
    barred = told(Terminal(), "starts, ", bar=True)
    assert "starts, 0 s" in barred
    assert "simulate" not in barred[barred.index("starts") :]  # before, where a busy processor begins the bar late
    lines = told(io.StringIO(), "starts: 0 so far, ", bar=True).splitlines()
    assert re.fullmatch(r"starts: 0 so far, \d+ s", lines[-1])
    monkeypatch.setattr(VOICE, "quiet", True)
    monkeypatch.setattr("flexopt.cli.common.TICK", 0.01)
    quiet = Terminal()
    with monkeypatch.context() as inside, context:
        inside.setattr("sys.stderr", quiet)
        with clock():
            time.sleep(0.1)
    assert quiet.getvalue() == ""


@pytest.mark.parametrize("width", [40, 60, 80, 100])
def test_tables_and_sentences_fit_the_terminal(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    text = repr(flexopt.explain(flexopt.load("excavator"), [0.9929, -2.6306], loop={"kp": 1e4, "kv": 1e3}))
    assert max(map(len, text.split("\n"))) > 100
    fitted = folded(text, width)
    assert max(map(len, fitted.split("\n"))) <= width
    # Nothing is lost, whatever its order; the first column of a table is there more than once.
    assert set(fitted.split()) == set(text.split())
    # A pipe gets lines as they are, a terminal as wide as it is.
    monkeypatch.setenv("COLUMNS", str(width))
    stream = Terminal()
    with monkeypatch.context() as inside:
        inside.setattr("sys.stdout", stream)
        common.say(text)
    assert stream.getvalue() == fitted + "\n"


def test_columns_of_a_table_stay_together() -> None:
    rows = [("mode", "frequency", "a much longer name of a column"), ("1", "2.5 Hz", "0.25"), ("2", "13.5 Hz", "-1.75")]
    text = "\n".join(f"{a:>6}  {b:>12}  {c:>32}" for a, b, c in rows)
    parts = folded(text, 40).split("\n")
    assert [line.split() for line in parts[:3]] == [["mode", "frequency"], ["1", "2.5", "Hz"], ["2", "13.5", "Hz"]]
    assert [line.split(maxsplit=1) for line in parts[3:]] == [[row[0], row[2]] for row in rows]
    assert folded(text, 200) == text


def test_a_part_of_a_table_has_only_lines_that_say_something() -> None:
    rows = [("rank", "x", ""), ("1", "0.25", ""), ("2", "-1.75", "rests on the singularity margin")]
    text = "\n".join(f"{a:>6}  {b:>12}  {c}".rstrip() for a, b, c in rows)
    assert folded(text, 40).split("\n")[3:] == ["     2  rests on the singularity margin"]


def test_an_interrupted_command_says_so(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("flexopt.cli.analysis.evaluate", interrupted)
    outcome = command("evaluate", "excavator", "--posture", "1,-2", "--json")
    assert outcome.code == 130
    assert outcome.stdout == ""
    assert outcome.stderr.strip() == "Aborted"


def test_help_of_the_article_names_every_figure() -> None:
    told = CliRunner().invoke(cli, ["reproduce", "--help"]).output
    for name in ("figure5", "figures11and12", "gains", "gaps"):
        assert name in told


def test_figures_of_the_article_are_named_where_they_are_written(
    command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Done:
        def write(self, _: str) -> None: ...

        def write_figures(self, folder: str, *, form: str, **_: object) -> tuple[Path, ...]:
            return Path(folder) / f"figure5.{form}", Path(folder) / f"gaps.{form}"

    monkeypatch.setattr("flexopt.article.reproduce", lambda **_: Done())
    told = command("reproduce", "--out", str(tmp_path), "--figures", "svg").stdout.split()
    assert f"{tmp_path / 'figure5.svg'}," in told
    assert told[-1] == str(tmp_path / "gaps.svg")


def test_words_behind_a_wide_table_leave_its_columns_whole() -> None:
    """No gap goes through what is said of each row: it goes on below, with what the row is about."""
    remarks = ("rests on lift upper bound, kink of w1, and one placement alike", "one of a set of dimension 2")
    rows = [f"  {k}  {k}.0000e+00  {k}.0000e-08  {words}" for k, words in enumerate(remarks, start=1)]
    parts = folded("\n".join(["  k          w1          w2", *rows]), 40).split("\n")
    assert parts[:3] == ["  k          w1          w2", "  1  1.0000e+00  1.0000e-08", "  2  2.0000e+00  2.0000e-08"]
    assert " ".join(" ".join(parts[3:]).split()) == f"1 {remarks[0]} 2 {remarks[1]}"
    assert parts[4].startswith("     ")
    assert max(map(len, parts)) <= 40


def test_a_file_of_another_kind_is_told_the_option_that_writes_it(command: Command) -> None:
    for name, option in (("page.html", "--html"), ("page.pdf", "--pdf or --plot"), ("bands.svg", "--plot")):
        outcome = command("verdict", "article", "--out", name)
        assert outcome.code == 2
        assert f"must end in .json; {option} writes .{name.split('.')[1]}" in outcome.stderr
    # `explore` has neither, and no command has an option for text.
    for words in (("explore", "excavator", "--out", "page.pdf"), ("verdict", "article", "--out", "page.txt")):
        outcome = command(*words)
        assert outcome.code == 2
        assert " writes " not in outcome.stderr


def test_a_folder_that_is_named_like_a_page_is_refused(command: Command) -> None:
    for words in (("report", "article"), ("reproduce",), ("export", "excavator")):
        outcome = command(*words, "--out", "report.html")
        assert outcome.code == 2
        assert "a folder is made of this name, and .html ends that of a file" in outcome.stderr
    assert list(command.folder.iterdir()) == []
