"""Names that no target expects: in pictures, in C, in XML and HTML, on terminals of any code page."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import unicodedata
import warnings
import xml.etree.ElementTree as ET
import zipfile
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import flexopt
from flexopt import machine_from_dict
from flexopt.export.fmu import export_fmu, package
from flexopt.foundation.escapes import (
    TERMINAL,
    ascii_text,
    c_identifier,
    c_text,
    markup,
    mathtext,
    of_option_list,
    one_line,
    option_list,
    terminal,
)
from flexopt.plotting import plot_trajectories

HOSTILE = {
    "mathtext": r"rig $x_{$",
    "half a formula": r"\alpha$ \$ $\frac{1}{$",
    "trigraphs": "???/",
    "more trigraphs": "a??/??' ??< ?????=",
    "end of a comment": "*/ int main(void) { return 1; } /*",
    "both at once": "/*/ */*",
    "end of a string": '"); exit(1); puts("',
    "line that goes on": "boom\\",
    "tags": "<b>&amp;</title><script>alert(1)</script>",
    "quotes": 'it\'s "quoted" `here`',
    "two lines": "one\ntwo\r\n#error three",
    "right to left": "\u202eegnaro\u2066 \u0627\u0644",
    "emoji": "😀 crane 👷🏽\u200d♀️",
    "Japanese": "掘削機-2",
    "control characters": "a\x00b\x07\x1b[31mred\x1b]0;title\x07\x7f",
    "no character": "a\ufffe\uffff",
    "percent": "%s%n 100 % $(rm) ${x} %d",
    "markdown": "| `a` | **b** | # c",
    "greek": "λᵀ ε̄₁",
    "only marks": "\u0301\u0302",
    "format marks": "{0} {name}",
    "long": "a very long name indeed " * 8,
}
# Each as the name of a machine once, and twice as one of its links.
NAMES = list(HOSTILE.values())
TRIPLES = [tuple(NAMES[(k + j) % len(NAMES)] for j in range(3)) for k in range(0, len(NAMES), 3)]
anything = st.text(st.characters(), max_size=40) | st.text("?*/\\$\"'<>&\n_^{}% a", max_size=20)


def machine(name: str, *links: str) -> flexopt.Machine:
    """The excavator under this name, its links under these."""
    data = json.loads(json.dumps(flexopt.load("excavator").to_dict()))
    data["name"] = name
    for link, word in zip(data["links"], links or (f"{name}1", f"{name}2"), strict=True):
        link["name"] = word
    return machine_from_dict(data)


@given(anything)
def test_any_text_in_c(text: str) -> None:
    plain = c_text(text)
    assert plain.isascii()
    assert plain.isprintable() or not plain
    assert not re.search(r'["\\]|\*/|/\*|\?\?', plain)
    assert re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", c_identifier(text))


@given(anything)
def test_any_text_in_markup(text: str) -> None:
    document = ET.fromstring(f'<a b="{markup(text)}">{markup(text)}</a>')
    assert (document.text or "") == document.attrib["b"] == one_line(text)


@given(anything, st.sampled_from(["ascii", "cp1252", "cp437", "cp932", "latin-1", "utf-8"]))
def test_any_text_on_a_terminal(text: str, encoding: str) -> None:
    shown = terminal(text).encode(encoding, TERMINAL).decode(encoding)
    assert not any(unicodedata.category(c) in ("Cc", "Cf", "Cs") and c != "\n" for c in shown)
    assert terminal(text).count("\n") == text.count("\n")
    assert ascii_text(text).isascii()


@settings(max_examples=20)
@given(anything)
def test_any_text_in_a_picture(text: str) -> None:
    """The text drawn is the text given, whatever stands beside it."""
    figure = Figure()
    figure.text(0.5, 0.5, mathtext(text))
    figure.text(0.5, 0.2, f"{mathtext(text)}: $w_1$")
    figure.savefig(io.BytesIO(), format="png", dpi=20)


def test_greek_and_script_letters_have_names() -> None:
    """Every letter that our own texts have beyond ASCII reads as something in it."""
    own = {c for path in Path(flexopt.__file__).parent.rglob("*.py") for c in path.read_text(encoding="utf-8")}
    unknown = [c for c in sorted(own) if ord(c) > 127 and unicodedata.category(c) != "Lo" and "\\" in ascii_text(c)]
    assert unknown == []
    assert ascii_text("λmin(R0 + R0ᵀ) − ω₁² ≤ ε") == "lambdamin(R0 + R0^T) - omega_1^2 <= epsilon"


def test_half_a_character_is_refused_as_a_name() -> None:
    with pytest.raises(flexopt.ModelError, match="holds half of a character"):
        machine("a\ud800b")


def test_names_that_are_plain_stay_as_they_are() -> None:
    for name in ("excavator", "boom-stick-bucket", "UR10e (2)", "arm_7.5 t"):
        assert [f(name) for f in (one_line, mathtext, c_text, terminal)] == [name] * 4
    assert (mathtext("Größe λ"), c_text("Größe")) == ("Größe λ", "Grosse")


@pytest.mark.long("names2", "names0", "names3", "names7")
@pytest.mark.parametrize("names", TRIPLES)
def test_pictures_of_a_run(tmp_path: Path, names: tuple[str, ...]) -> None:
    loaded = machine(*names)
    run = flexopt.simulate(loaded, posture=(0.9, -2.0), duration=0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run.plot(tmp_path / "run.svg")
        plot_trajectories({names[1]: run, "other": run}, tmp_path / "both.png")
    written = "".join(ET.parse(tmp_path / "run.svg").getroot().itertext())
    assert written.strip()


@pytest.mark.long
def test_every_other_picture(tmp_path: Path) -> None:
    """Of a machine whose name is half a formula and wants another font."""
    name = HOSTILE["half a formula"] + HOSTILE["Japanese"]
    capsule = {"body": f"{name}2", "start": [0.0, 0.0], "end": [1.0, 0.0], "radius": 0.05}
    loaded = machine_from_dict(machine(name).to_dict() | {"capsules": [capsule]})
    obstacle = {"name": name, "kind": "sphere", "center": [3.0, 4.0], "radius": 0.2}
    chosen = flexopt.select(
        loaded, (0.0, 1.6), workers=1, constraints={"clearance": {"distance": 0.05, "obstacles": [obstacle]}}
    )
    stand = flexopt.select_stand(loaded, [(0.0, 1.6), (0.2, 1.6)], starts=1, workers=1)
    field = flexopt.map_workspace(loaded, points=(4, 4), over="posture", epsilon_max=False)
    atlas = flexopt.atlas(loaded, cells=(8, 8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k, result in enumerate((chosen, stand, field, atlas)):
            result.plot(tmp_path / f"{k}.png")
        chosen.plot(tmp_path / "a.pdf")


@pytest.mark.parametrize("word", ["mathtext", "tags"])
def test_films(tmp_path: Path, word: str) -> None:
    run = flexopt.simulate(machine(HOSTILE[word]), posture=(0.9, -2.0), duration=0.05)
    run.animate(tmp_path / "run.html", speed=0.1)
    assert "<script>alert" not in (tmp_path / "run.html").read_text(encoding="utf-8")


STRICT = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wtrigraphs",
    "-Wcomment",
    "-Wformat",
    "-pedantic",
    "-Werror",
    "-fsyntax-only",
]


@pytest.mark.needs("gcc", "clang")
@pytest.mark.parametrize("names", TRIPLES)
def test_bundles_compile_without_a_warning(tmp_path: Path, names: tuple[str, ...]) -> None:
    loaded = machine(*names)
    report = flexopt.export_c(loaded, tmp_path / "c", parts=["kinematics", "controller"])
    sources = sorted(p for p in report.folder.rglob("*.c") if "target" not in p.parts)
    assert len(sources) > 4
    for path in report.folder.rglob("*.[ch]"):
        text = path.read_text(encoding="utf-8")
        assert text.isascii(), path
        assert "??" not in text, path
    include = [f"-I{folder}" for folder in {p.parent for p in report.folder.rglob("*.h")}]
    for compiler in ("gcc", "clang"):
        done = subprocess.run(
            [compiler, *STRICT, *include, *map(str, sources)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.needs("gcc")
@pytest.mark.parametrize("names", TRIPLES[::2])
def test_fmus(tmp_path: Path, names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its description is XML that tells the name, its page is HTML without strange tags, its C compiles."""
    monkeypatch.setattr(package, "level_for", lambda _: ("-O0",))
    export_fmu(machine(*names), tmp_path / "m.fmu", posture=(0.9, -2.0), duration=0.05)
    with zipfile.ZipFile(tmp_path / "m.fmu") as archive:
        archive.extractall(tmp_path / "out")
    root = ET.parse(tmp_path / "out" / "modelDescription.xml").getroot()
    assert root.attrib["modelName"] == one_line(names[0])
    pages = list((tmp_path / "out").rglob("*.html"))
    assert pages
    for path in pages:
        assert "script" not in tags(path.read_text(encoding="utf-8"))
    source = tmp_path / "out" / "sources" / "fmu.c"
    done = subprocess.run(
        ["gcc", *STRICT[:-2], "-Werror", "-fsyntax-only", str(source)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


class Texts(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append(tag)


def tags(text: str) -> list[str]:
    reader = Texts()
    reader.feed(text)
    return reader.tags


@pytest.mark.long
def test_pages(tmp_path: Path) -> None:
    """A whole report on a machine with a hostile name."""
    name = HOSTILE["tags"]
    data = machine(name, HOSTILE["mathtext"], "b").to_dict()
    # With one mode there are fewer pictures.
    for key in ("stiffness", "damping"):
        data["base"][key] = {"rotation": data["base"][key]["rotation"]}
    problem = flexopt.build_selection(flexopt.machine_from_dict(data), (0.0, 1.6), starts=1)
    result = flexopt.report(problem, points=4, simulation={"duration": 0.1})
    result.write(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    # The page's own, which unfolds it for paper.
    assert tags(text).count("script") == 1
    assert markup(name) in text


def run_command(
    encoding: str, *arguments: str, folder: Path | None = None, **more: str
) -> subprocess.CompletedProcess[bytes]:
    environment = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"} | more
    return subprocess.run(
        [sys.executable, "-c", "from flexopt.cli import main; main()", *arguments],
        capture_output=True,
        env=environment,
        cwd=folder,
        check=False,
    )


@pytest.mark.parametrize(
    ("encoding", "wanted"),
    [("ascii", b"lambdamin(R0 + R0^T)"), ("cp1252", b"lambdamin(R0 + R0^T)"), ("utf-8", "λmin(R0 + R0ᵀ)".encode())],
)
def test_consoles_of_any_code_page(tmp_path: Path, encoding: str, wanted: bytes) -> None:
    """Nothing garbled, nothing lost, nothing that moves the cursor."""
    path = tmp_path / "digger.toml"
    lines = (Path(flexopt.__file__).parents[1] / "models" / "excavator.toml").read_text(encoding="utf-8")
    path.write_text(lines.replace('name = "excavator"', 'name = "Bagger\\u001b[31m λ 掘"'), encoding="utf-8")
    done = run_command(encoding, "evaluate", str(path), "--posture", "0.5,-1")
    assert done.returncode == 0, done.stderr
    assert wanted in done.stdout
    assert b"\x1b" not in done.stdout + done.stderr
    assert b"?" not in done.stdout
    first = done.stdout.splitlines()[0].decode(encoding)
    assert first.startswith("Bagger [31m λ 掘" if encoding == "utf-8" else r"Bagger [31m lambda \u6398")
    failed = run_command(encoding, "evaluate", "λ\x1b[31m", "--posture", "0.5,-1")
    assert failed.returncode == 2
    assert b"\x1b" not in failed.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere paths are Unicode")
@pytest.mark.parametrize("arguments", [("check", "é.toml"), ("compare", "é.json", "é.json")])
def test_a_path_that_the_locale_cannot_read_is_spelled_in_one_way(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    """As Python spells its bytes, whether it stands between quotes or not."""
    done = run_command("ascii", *arguments, folder=tmp_path, LC_ALL="C", PYTHONCOERCECLOCALE="0")
    assert done.returncode == 2
    suffix = Path(arguments[1]).suffix
    said = (done.stdout + done.stderr).decode("ascii")
    assert said.count(suffix) == said.count(ascii("é".encode().decode("ascii", "surrogateescape"))[1:-1] + suffix) > 1


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere paths are Unicode")
def test_a_page_goes_to_a_path_that_the_locale_cannot_read(tmp_path: Path) -> None:
    done = run_command(
        "ascii", "explore", "excavator", "--out", "é.html", folder=tmp_path, LC_ALL="C", PYTHONCOERCECLOCALE="0"
    )
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["é.html"]


@given(st.lists(anything.map(lambda text: " ".join(text.split())).filter(bool), min_size=1, max_size=4))
def test_an_option_takes_names_with_commas(names: list[str]) -> None:
    """What is told to be given is read as the names it was told of."""
    assert of_option_list(option_list(names)) == names
    assert of_option_list(", ".join(option_list([name]) for name in names)) == names
