"""Bundles examined: on this computer, on emulated processors, and what an examination notices."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import flexopt
from flexopt.cli import main
from flexopt.errors import InputError
from flexopt.export import PARTS, export_c, verify_bundle
from flexopt.export.bundle import library_of, read_manifest
from flexopt.export.verify import objects, tools
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import VerificationCheck
from flexopt.export.verify.misra import in_pieces
from tests.export.programs import HOST, TARGET
from tests.oracles.cylinders import digger


def exported(folder: Path, **options) -> Path:
    return export_c(flexopt.load("excavator"), folder, **options).folder


def turning_only() -> flexopt.Machine:
    """The excavator with one mode: the C of all its parts is half as long, of the same statements."""
    data = flexopt.load("excavator").to_dict()
    for key in ("stiffness", "damping"):
        data["base"][key] = {"rotation": data["base"][key]["rotation"]}
    return flexopt.machine_from_dict(data)


def with_cylinders() -> flexopt.Machine:
    return flexopt.machine_from_dict(digger())


def named(checks: tuple[VerificationCheck, ...], name: str) -> VerificationCheck:
    return next(check for check in checks if check.name.startswith(name))


def rows(check: VerificationCheck, title: str) -> list[dict]:
    return next(t.to_dict()["rows"] for t in check.tables if t.title.startswith(title))


# Of each function; `flexopt verify` takes five times as many.
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
    folder = export_c(make(), tmp_path / "b", real=real, parts=parts).folder
    result = verify_bundle(folder, target="host", inputs=INPUTS, fuzz_calls=CALLS)
    assert result.passed and result.complete, repr(result)  # noqa: PT018
    for compiler in ("gcc", "clang"):
        found = rows(named(result.checks, f"equal to Python, {compiler}"), "Against Python")
        assert len(found) == outputs
        assert all(row["calls compared"] == INPUTS for row in found)
        assert all(row["largest error / scale"] <= (1e-12 if real == "double" else 1e-4) for row in found)
    fuzzed = rows(named(result.checks, "faulty calls"), "Faulty calls")
    assert len(fuzzed) == functions
    for row in fuzzed:
        assert row["calls"] == CALLS
        assert CALLS / 20 < row["succeeded"] < 0.9 * CALLS
        for status in ("NULL_POINTER", "BAD_WORKSPACE", "NOT_FINITE", "OUT_OF_RANGE"):
            assert row[status] > CALLS / 100
    written = json.loads((folder / "verification" / "report.json").read_text())
    assert [c["name"] for c in written["checks"]] == [c.name for c in result.checks]
    page = (folder / "verification" / "report.html").read_text()
    assert "cortex-m7 (not asked for)" in page


@pytest.mark.long
@TARGET
@pytest.mark.parametrize(
    ("real", "make", "target"),
    [("float", lambda: flexopt.load("excavator"), "cortex-m4f"), ("double", turning_only, "cortex-m7")],
    ids=["float on M4F", "double on M7"],
)
def test_everything_holds_on_emulated_processors(real: str, make, target, tmp_path: Path) -> None:
    folder = export_c(make(), tmp_path / "b", real=real).folder
    result = verify_bundle(folder, target=target, inputs=100)
    assert result.passed and result.complete, repr(result)  # noqa: PT018
    check = named(result.checks, "equal to Python")
    counted = {row["function"]: row for row in rows(check, "One call")}
    assert 100 < counted["torque_inverse"]["instructions, most"] < 1_500
    assert counted["robust_margin"]["instructions, most"] < 2_000_000
    assert all(0 < row["stack of a call, bytes (painted)"] < 8_192 for row in counted.values())
    memory = rows(named(result.checks, "flash and RAM"), "Memory")
    assert all(row["static RAM, bytes"] == 0 < row["flash, bytes"] for row in memory)
    if real == "float":
        plain, kernel, *_ = rows(named(result.checks, "against the plain"), "Controller step")
        assert plain["instructions"] >= 10 * kernel["instructions"] > 0


@pytest.mark.long
@TARGET
def test_software_double_on_a_processor_without_it(tmp_path: Path) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics", "controller", "measures"], baked=True)
    result = verify_bundle(folder, target="cortex-m4f", inputs=200)
    assert result.passed and result.complete, repr(result)  # noqa: PT018


@pytest.mark.long
@HOST
def test_a_wrong_constant_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = exported(tmp_path / "b", parts=["controller"])
    source = folder / "src" / "excavator_controller.c"
    text = source.read_text()
    product = re.search(r"a\d+ ?= ?\(a\d+\*a\d+\);", text)
    assert product is not None
    source.write_text(text.replace(product[0], product[0].replace(";", "*1.000000001;"), 1))
    with pytest.raises(SystemExit) as left:
        main(["verify", str(folder), "--target", "host", "--inputs", "50", "--fuzz-calls", "100", "--json"])
    assert left.value.code == 3
    document = json.loads(capsys.readouterr().out)
    states = {check["name"]: check["state"] for check in document["checks"]}
    assert states["files as they were exported"] == "failed"
    assert states["equal to Python, gcc"] == "failed"
    assert states["README followed, gcc"] == "failed"
    assert not document["passed"]


def examined(folder: Path, scratch: Path, inputs: int = 10, fuzz_calls: int = 10) -> Bench:
    manifest = read_manifest(folder)
    scratch.mkdir()
    return Bench(folder, scratch, manifest, library_of(manifest), inputs, fuzz_calls)


def test_missing_tools_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = exported(tmp_path / "b", parts=["kinematics"])
    which = tools.shutil.which
    monkeypatch.setattr(tools.shutil, "which", lambda name: None if name.startswith(("qemu", "arm-")) else which(name))
    counted: list[tuple[int, int]] = []
    result = verify_bundle(folder, target="cortex-m7", inputs=10, progress=lambda *count: counted.append(count))
    assert counted == [(k + 1, len(result.checks)) for k in range(len(result.checks))]
    assert not result.complete
    assert not result.failed
    assert any("qemu-system-arm" in line for line in result.not_verified)
    assert any("apt-get install" in line for line in result.not_verified)


def test_reports_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is broken off says how far it came; one on other targets is not replaced, until there is other code."""
    folder = exported(tmp_path / "b", parts=["kinematics"])
    reports, which = folder / "verification", tools.shutil.which
    monkeypatch.setattr(tools.shutil, "which", lambda name: None if name.startswith(("qemu", "arm-")) else which(name))

    def told(name: str = "report") -> dict:
        return json.loads((reports / f"{name}.json").read_text())

    def broken_off(done: int, _: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        verify_bundle(folder, target="cortex-m7", inputs=10, progress=broken_off)
    files, tried, *rest = told()["checks"]
    assert files["state"] == "passed"
    assert "qemu" in tried["finding"]
    assert {check["finding"] for check in rest} == {"broken off before"}
    verify_bundle(folder, target="cortex-m7", inputs=10)
    assert len(told()["checks"]) == 2 + len(rest)
    assert "broken off" not in (reports / "report.html").read_text()
    verify_bundle(folder, target="cortex-m4f", inputs=10)
    assert (told()["targets"], told("report-cortex-m7")["targets"]) == (["cortex-m4f"], ["cortex-m7"])
    assert "cortex-m4f (not asked for)" in (reports / "report-cortex-m7.html").read_text()
    exported(tmp_path / "b", parts=["kinematics", "controller"])
    assert not list(reports.glob("report*"))


def test_a_folder_that_is_no_bundle_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no manifest\.json"):
        verify_bundle(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        verify_bundle(tmp_path / "nowhere")
    with pytest.raises(InputError, match="target") as caught:
        verify_bundle(tmp_path, target="toaster", inputs=0)  # type: ignore[arg-type]
    assert {fault.field for fault in caught.value.faults} == {"target", "inputs"}


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
    folder = exported(tmp_path / "b", parts=["kinematics"], real="float")
    with (folder / "src" / "excavator_kinematics.c").open("a") as file:
        file.write(f"\n{addition}\n")
    bench = examined(folder, tmp_path / "scratch")
    compiler, flags = ("gcc", ["-fno-pic"]) if target == "host" else ("arm-none-eabi-gcc", ["-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"])  # fmt: skip
    check = objects.objects_check(bench, target, compiler, ["-O1", *flags]).made()
    assert check.state == "failed"
    assert sentence in check.finding


def test_kernels_are_cut_without_losing_a_statement() -> None:
    statements = [f"  a{k} = (a{k}+a{k});" for k in range(450)]
    text = "static int kernel_x(const r **arg) {\n  m_real a0, a1;\n" + "\n".join(statements) + "\n  return 0;\n}\n"
    cut = in_pieces(text)
    assert cut.count("static int") == 3
    assert [line for line in cut.splitlines() if "=" in line] == statements
