"""Bundles verified by a user, and examined on this computer and on emulated processors; what both notice."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pytest

import flexopt
from flexopt.cli import main
from flexopt.errors import InputError
from flexopt.export import PARTS, ExportReport, export_c, verify_bundle
from flexopt.export.verify import tools
from flexopt.export.verify.checks import Finding
from flexopt.export.verify.host import host_checks
from flexopt.export.verify.verification import FILES
from tests.export.emulated import boards, faulty, objects
from tests.export.emulated.examining import HOST_FLAGS, examine_board, examine_host, opened
from tests.export.emulated.misra import in_pieces
from tests.export.programs import GCC, HOST, TARGET
from tests.oracles.cylinders import digger


def exported(folder: Path, **options) -> ExportReport:
    return export_c(flexopt.load("excavator"), folder, **options)


def turning_only() -> flexopt.Machine:
    """The excavator with one mode: the C of all its parts is half as long, of the same statements."""
    data = flexopt.load("excavator").to_dict()
    for key in ("stiffness", "damping"):
        data["base"][key] = {"rotation": data["base"][key]["rotation"]}
    return flexopt.machine_from_dict(data)


def with_cylinders() -> flexopt.Machine:
    return flexopt.machine_from_dict(digger())


def rows(finding: Finding, title: str) -> list[dict]:
    return next(t.to_dict()["rows"] for t in finding.tables if t.title.startswith(title))


@GCC
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_bundle_is_verified_by_one_compiler_alone(real: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    which = tools.shutil.which
    monkeypatch.setattr(tools.shutil, "which", lambda name: which(name) if name == "gcc" or "/" in name else None)
    folder = exported(tmp_path / "b", real=real, parts=["kinematics", "controller"]).folder
    counted: list[tuple[int, int]] = []
    result = verify_bundle(folder, inputs=50, progress=lambda *count: counted.append(count))
    assert result.passed, repr(result)
    assert counted == [(1, 3), (2, 3), (3, 3)]
    assert result.not_verified == ()
    assert list(result.tools) == ["gcc"]
    (compared,) = (rows(check, "Against Python") for check in result.checks if check.tables)
    assert {row["function"] for row in compared} == {"kinematics", "torque_transpose", "torque_inverse"}
    assert all(row["calls compared"] == 50 for row in compared)
    assert all(0 <= row["largest error / scale"] <= (1e-12 if real == "double" else 1e-4) for row in compared)
    written = json.loads((folder / "verification" / "report.json").read_text())
    assert [check["name"] for check in written["checks"]] == [check.name for check in result.checks]
    assert "largest error / scale" in (folder / "verification" / "report.html").read_text()
    assert main(["verify", str(folder), "--inputs", "5"]) is None


@GCC
def test_a_wrong_constant_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = exported(tmp_path / "b", parts=["controller"]).folder
    source = folder / "src" / "excavator_controller.c"
    text = source.read_text()
    product = re.search(r"a\d+ ?= ?\(a\d+\*a\d+\);", text)
    assert product is not None
    source.write_text(text.replace(product[0], product[0].replace(";", "*1.000000001;"), 1))
    with pytest.raises(SystemExit) as left:
        main(["verify", str(folder), "--inputs", "50", "--json"])
    assert left.value.code == 3
    document = json.loads(capsys.readouterr().out)
    states = {check["name"]: check["state"] for check in document["checks"]}
    assert states == {FILES: "failed", "self-test": "not verified", "equal to Python": "not verified"}
    assert not document["passed"]
    # The bundle's own tests notice it, too.
    assert [check.made().state for check in host_checks(opened(folder, tmp_path / "s", 50))] == ["failed", "failed"]


@GCC
@pytest.mark.parametrize("planted", ["test/selftest.c", "include/math.h", "Makefile", "manifest.json"])
def test_nothing_of_a_changed_bundle_is_run(planted: str, tmp_path: Path) -> None:
    """A program, a header that shadows one of the system's, a makefile, a manifest that vouches for a program."""
    folder, mark = exported(tmp_path / "b", parts=["kinematics"]).folder, tmp_path / "mark"
    program = f'#include <stdio.h>\nint main(void) {{ fclose(fopen("{mark}", "w")); puts("all passed"); return 0; }}\n'
    if planted == "manifest.json":
        (folder / "test" / "selftest.c").write_text(program)
        manifest = json.loads((folder / planted).read_text())
        manifest["files"]["test/selftest.c"] = hashlib.sha256(program.encode()).hexdigest()
        (folder / planted).write_text(json.dumps(manifest))
    else:
        (folder / planted).write_text(f"#error planted\n{program}" if planted.endswith(".h") else program)
    result = verify_bundle(folder, inputs=5)
    # A file that the bundle does not have is not looked at, and not compiled.
    assert result.passed == (planted == "include/math.h"), repr(result)
    assert not mark.exists()


@pytest.mark.parametrize("key", ["machine", "options", "provenance", "files"])
@pytest.mark.parametrize("value", [None, 3, "text", [], {}, {"real": 3}])
def test_a_manifest_that_describes_nothing_is_refused(key: str, value: object, tmp_path: Path) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics"]).folder
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {key: value}))
    try:
        assert not verify_bundle(folder, inputs=5).passed
    except InputError as error:
        assert key in ("machine", "options", "files"), error  # noqa: PT017 - either is an answer


def test_without_a_compiler_nothing_has_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics"]).folder
    monkeypatch.setattr(tools.shutil, "which", lambda _: None)
    with pytest.raises(SystemExit) as left:
        main(["verify", str(folder)])
    assert left.value.code == 3
    said = capsys.readouterr().out
    assert said.count("no C compiler found (cc, gcc, clang)") == 2
    assert "1 checks passed, 2 checks not verified" in said


def test_a_report_tells_how_far_it_came(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics"]).folder
    reports = folder / "verification"
    monkeypatch.setattr(tools.shutil, "which", lambda _: None)

    def broken_off(done: int, _: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        verify_bundle(folder, inputs=10, progress=broken_off)
    files, tried, last = json.loads((reports / "report.json").read_text())["checks"]
    assert files["state"] == "passed"
    assert "no C compiler" in tried["finding"]
    assert last["finding"] == "broken off before"
    exported(tmp_path / "b", parts=["kinematics", "controller"], overwrite=True)
    assert not list(reports.glob("report*"))


def test_a_folder_that_is_no_bundle_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no manifest\.json"):
        verify_bundle(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        verify_bundle(tmp_path / "nowhere")
    with pytest.raises(InputError, match="inputs"):
        verify_bundle(tmp_path, inputs=0)


# Of each function.
INPUTS, CALLS = 200, 2_000


@pytest.mark.long
@HOST
@pytest.mark.parametrize(
    ("real", "make", "parts", "functions", "outputs"),
    [
        ("double", turning_only, [part for part in PARTS if part not in ("levers", "loop")], 7, 15),
        ("float", with_cylinders, ["kinematics", "controller", "levers"], 5, 8),
    ],
    ids=["double", "float"],
)
def test_everything_holds_on_the_host(real: str, make, parts, functions: int, outputs: int, tmp_path: Path) -> None:
    report = export_c(make(), tmp_path / "b", real=real, parts=parts)
    found = examine_host(report, tmp_path / "scratch", INPUTS, CALLS)
    for compiler in ("gcc", "clang"):
        compared = rows(found[f"equal to Python, {compiler}"], "Against Python")
        assert len(compared) == outputs
        assert all(row["calls compared"] == INPUTS for row in compared)
        assert all(row["largest error / scale"] <= (1e-12 if real == "double" else 1e-4) for row in compared)
    fuzzed = rows(found["faulty calls"], "Faulty calls")
    assert len(fuzzed) == functions
    for row in fuzzed:
        assert row["calls"] == CALLS
        assert CALLS / 20 < row["succeeded"] < 0.9 * CALLS
        for status in ("NULL_POINTER", "BAD_WORKSPACE", "NOT_FINITE", "OUT_OF_RANGE"):
            assert row[status] > CALLS / 100


@pytest.mark.long
@TARGET
@pytest.mark.parametrize(
    ("real", "make", "target"),
    [("float", lambda: flexopt.load("excavator"), "cortex-m4f"), ("double", turning_only, "cortex-m7")],
    ids=["float on M4F", "double on M7"],
)
def test_everything_holds_on_emulated_processors(real: str, make, target: str, tmp_path: Path) -> None:
    folder = export_c(make(), tmp_path / "b", real=real).folder
    found = examine_board(folder, tmp_path / "scratch", target, 100)
    counted = {row["function"]: row for row in rows(found["equal to Python"], "One call")}
    assert 100 < counted["torque_inverse"]["instructions, most"] < 1_500
    assert counted["robust_margin"]["instructions, most"] < 2_000_000
    assert all(0 < row["stack of a call, bytes (painted)"] < 8_192 for row in counted.values())
    memory = rows(found["memory"], "Memory")
    assert all(row["static RAM, bytes"] == 0 < row["flash, bytes"] for row in memory)
    if real == "float":
        plain, kernel, *_ = rows(found["plain"], "Controller step")
        assert plain["instructions"] >= 10 * kernel["instructions"] > 0


@pytest.mark.long
@TARGET
def test_software_double_on_a_processor_without_it(tmp_path: Path) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics", "controller", "measures"], baked=True).folder
    examine_board(folder, tmp_path / "scratch", "cortex-m4f", 200)


@TARGET
@pytest.mark.parametrize(("real", "target"), [("float", "cortex-m4f"), ("double", "cortex-m7")])
def test_a_controller_holds_on_emulated_processors(real: str, target: str, tmp_path: Path) -> None:
    folder = exported(tmp_path / "b", real=real, parts=["kinematics", "controller"]).folder
    found = examine_board(folder, tmp_path / "scratch", target, 20)
    assert {row["function"] for row in rows(found["equal to Python"], "One call")} >= {"kinematics", "torque_inverse"}


@GCC
@pytest.mark.parametrize(
    ("right", "wrong", "sentence"),
    [
        ("", "", ""),
        ("(given == 0) || ", "", "null pointer"),
        ("length < needed", "length < 1U", "with a bad pointer succeeded"),
    ],
)
def test_a_check_that_is_missing_is_found(right: str, wrong: str, sentence: str, tmp_path: Path) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics"]).folder
    source = folder / "src" / "excavator_internal.h"
    text = source.read_text()
    assert not right or text.count(right) == 1
    source.write_text(text.replace(right, wrong, 1) if right else text)
    faults = faulty.fuzzed(opened(folder, tmp_path / "scratch"), 500).faults
    assert any(sentence in fault for fault in faults) if right else not faults


@pytest.mark.parametrize(
    "loop",
    [
        "while (x > 0) { x = x - 1; }",
        "for (i = 0; i < n; ++i) { --i; }",
        "for (i = 0; i < n; ++i) { n = n + 1; }",
        "for (;;) { break; }",
        "for (i = 0; x > eps; ++i) { x = x / 2; }",
        "again: goto again;",
        "for (int i = 0; x[i] > 0; i++) { x[i] = 1; }",
        "for (int i = 0; i < n || x > 0; i++) { x = 1; }",
        "for (int i = n; i < n; i--) { x = 1; }",
        "for (int i = 0; i < s->n; i++) { s->n++; }",
    ],
)
def test_unbounded_loops_are_noticed(loop: str) -> None:
    assert objects.unbounded_loops(f"int f(int n) {{\n  {loop}\n}}")[1]


def test_bounded_loops_are_counted() -> None:
    text = "for (i = 0; i < 3; ++i) {\n  y[i] = 2;\n}\nfor (i=0, rr=w; i<10; ++i) *rr++ = *cs++;\n/* while */\n"
    assert objects.unbounded_loops(text) == (2, [])


def test_recursion_and_stack_are_read_from_the_call_graph() -> None:
    graph = objects.CallGraph({"a": {"b"}, "b": {"c"}}, {"a": 8, "b": 16, "c": 4}, set())
    assert graph.cycle() == []
    assert graph.stack_from("a") == 28
    graph.calls["c"] = {"a"}
    assert set(graph.cycle()) == {"a", "b", "c"}


def test_functions_of_one_name_in_two_files_are_two(tmp_path: Path) -> None:
    """f calls g in one file, and g calls f in the other: no recursion."""
    for file, (above, below) in {"one": ("f", "g"), "two": ("g", "f")}.items():
        lines = [f'node: {{ title: "{file}.c:{name}" label: "{name}\\n{file}.c:1:1\\n{size} bytes (static)" }}'
                 for name, size in ((above, 8), (below, 16))]  # fmt: skip
        lines += [f'node: {{ title: "{file}" label: "{file}\\n{file}.c:2:1\\n4 bytes (static)" }}']
        lines += [f'edge: {{ sourcename: "{file}" targetname: "{file}.c:{above}" label: "{file}.c:2:9" }}']
        lines += [f'edge: {{ sourcename: "{file}.c:{above}" targetname: "{file}.c:{below}" label: "{file}.c:1:9" }}']
        (tmp_path / f"{file}.ci").write_text("\n".join(lines))
    graph = objects.call_graph({file: tmp_path / f"{file}.o" for file in ("one", "two")})
    assert graph.cycle() == []
    assert graph.stack_from("one") == graph.stack_from("two") == 28


@pytest.mark.parametrize(
    ("addition", "sentence"),
    [
        ("static int calls; int excavator_more(void); int excavator_more(void) { return ++calls; }", "state in calls"),
        ("#include <stdlib.h>\nvoid *excavator_more(void); void *excavator_more(void) { return malloc(3); }", "malloc"),
        ("float excavator_more(float x); float excavator_more(float x) { return (float)(x * 0.1); }", "doubles"),
        (
            "int excavator_more(int n); int excavator_more(int n) { return n < 2 ? 1 : n * excavator_more(n / 3); }",
            "recursion: excavator_more",
        ),
    ],
)
@pytest.mark.parametrize(
    "target",
    [
        pytest.param("host", marks=pytest.mark.needs("gcc", "nm", "objdump")),
        pytest.param("cortex-m4f", marks=TARGET),
    ],
)
def test_objects_show_what_may_not_be(addition: str, sentence: str, target, tmp_path: Path) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics"], real="float").folder
    with (folder / "src" / "excavator_kinematics.c").open("a") as file:
        file.write(f"\n{addition}\n")
    bench = opened(folder, tmp_path / "scratch")
    board = boards.BOARDS.get(target)
    compiler, flags = ("gcc", HOST_FLAGS) if board is None else (boards.COMPILER, boards.flags_of(board))
    faults = objects.examined(bench, target, compiler, [*flags, "-O1"]).faults
    assert any(sentence in fault for fault in faults)


def test_kernels_are_cut_without_losing_a_statement() -> None:
    statements = [f"  a{k} = (a{k}+a{k});" for k in range(450)]
    text = "static int kernel_x(const r **arg) {\n  m_real a0, a1;\n" + "\n".join(statements) + "\n  return 0;\n}\n"
    cut = in_pieces(text)
    assert cut.count("static int") == 3
    assert [line for line in cut.splitlines() if "=" in line] == statements
