"""The page of a report: its box says the verdict's own numbers; in Chromium it fits, folds, chooses and prints."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pypdf
import pytest
from playwright.sync_api import Browser

import flexopt
from flexopt.foundation import printing
from flexopt.foundation.rendering import OfNumbers, _environment, render
from flexopt.selection import Selection
from flexopt.selection.constraints.corners import WHERE
from flexopt.selection.several import Stand
from flexopt.study import page as study_page
from flexopt.study.reports import page as report_page
from flexopt.study.reports import tables
from flexopt.study.reports.page import report_html
from flexopt.study.verdicts.result import STAY
from tests.browser import on_paper, page_of, wide_tables
from tests.cli.command import Command

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
LOOP = {"kp": 1e4, "kv": 1e3}
VOID = {"meta", "img", "input", "br", "link"}
# Width of what is printed on a page of A4, in the CSS's pixels.
PAPER = round((210 - 24) / 25.4 * 96)
# The pictures that are shown, and their grounds.
SHOWN = "[...document.images].filter((each) => each.checkVisibility())"
GROUNDS = f"[...new Set({SHOWN}.map((each) => each.className.replace('on-', '').replace(' own', '')))]"


class Parsed(HTMLParser):
    """Elements in order: (name, attributes, text); tags must close as they open."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None], list[str], tuple[str, ...]]] = []
        self.open: list[int] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        around = tuple(self.elements[k][0] for k in self.open)
        self.elements.append((tag, dict(attrs), [], around))
        if tag not in VOID:
            self.open.append(len(self.elements) - 1)

    def handle_endtag(self, tag: str) -> None:
        assert self.elements[self.open.pop()][0] == tag

    def handle_data(self, data: str) -> None:
        for k in self.open:
            self.elements[k][2].append(data)

    def all(self, tag: str, within: str = "") -> list[tuple[dict[str, str | None], str]]:
        return [
            (attributes, " ".join("".join(text).split()))
            for name, attributes, text, around in self.elements
            if name == tag and (not within or within in around)
        ]


@pytest.fixture(scope="module")
def judged() -> flexopt.Report:
    """A machine in the plane, with a controller."""
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), base=0.0, starts=4)
    return flexopt.report(problem, loop=LOOP, simulation={"duration": 2.0}, points=6)


@pytest.fixture(scope="module")
def crowded() -> flexopt.Report:
    """Many passive coordinates and constraints: the widest tables there are."""
    return flexopt.report(flexopt.load_problem("pipe-laying"), loop="default", simulation={"duration": 2.0}, points=5)


_pages: dict[int, str] = {}


def page_text(report: flexopt.Report) -> str:
    """Of a module's report, drawn once."""
    if id(report) not in _pages:
        _pages[id(report)] = report_html(report)
    return _pages[id(report)]


LONG = [pytest.param(name, marks=pytest.mark.long) for name in ("crowded", "stations", "trench")]


@pytest.fixture(scope="module", params=["judged", *LONG])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param in ("judged", "crowded"):
        report = request.getfixturevalue(request.param)
        text = page_text(report)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(report_page, "report_html", lambda _: text)
            return report.write(tmp_path_factory.mktemp(request.param))[0]
    report = flexopt.report(flexopt.load_problem(request.param), simulation={"duration": 2.0}, points=4)
    return report.write(tmp_path_factory.mktemp(request.param))[0]


@pytest.mark.long
def test_the_chosen_place_is_the_verdicts(judged: flexopt.Report) -> None:
    """In pictures, map, loops and words, though another candidate is the best by the objective; in the box, too."""
    verdict = judged.verdict
    assert verdict is not None
    place = next(each for each in verdict.places if each.name == verdict.place)
    assert verdict.place not in ("", STAY, "candidate 1")
    stand = judged.stands["chosen"]
    assert [*stand.base, *stand.posture] == [*np.ravel(place.base), *np.ravel(place.posture)]
    run = judged.loops["chosen"].run
    assert run.base[0].tolist() == stand.base.tolist()
    assert judged.selection.best is judged.selection.candidates[0]
    # The map is over the end-point as the arm's root sees it.
    arm = stand.skeleton[:, -1] - stand.skeleton[:, 1]
    assert judged.marks["chosen"] == pytest.approx(arm.tolist(), abs=1e-12)
    best = judged.selection.best.evaluation.skeleton
    assert abs(arm - (best[:, -1] - best[:, 1])).max() > 1.0
    figure = judged.about.plot()
    # Of every panel over the base's place: the star, and one dot for each of the others.
    for axes in figure.axes:
        drawn = {line.get_label(): np.atleast_1d(line.get_xdata()).astype(float) for line in axes.get_lines()}
        if "chosen" in drawn:
            assert drawn["chosen"] == pytest.approx(stand.base)
            dots = np.concatenate([drawn.get(name, []) for name in ("other local optima", "further below")])
            numbered = enumerate(judged.selection.candidates, start=1)
            bases = [each.z[0] for k, each in numbered if f"candidate {k}" != verdict.place]
            assert sorted(dots) == pytest.approx(sorted(bases))
    assert sum("chosen" in [line.get_label() for line in axes.get_lines()] for axes in figure.axes) == 3
    page = Parsed(page_text(judged))
    words = f"Chosen: {verdict.place}, which the verdict is about; candidate 1 has the best w1."
    assert [text.count(words) for _, text in page.all("figcaption")].count(1) == 1
    assert words in [text for _, text in page.all("p")]
    # What is told of the choice's own best is not of the one that is drawn.
    said = f"Of candidate 1: {'; '.join(judged.selection.remarks)}"
    assert any(text.startswith(study_page.sentence(said)) for _, text in page.all("p"))
    assert f"{verdict.place} (drawn as chosen: the verdict's)" in {
        text for tag in ("th", "td") for _, text in page.all(tag)
    }


@pytest.mark.long
def test_of_several_targets_the_stand_of_the_verdict_is_drawn(tmp_path: Path) -> None:
    file = tmp_path / "two.toml"
    file.write_text(
        'schema = 1\nname = "two"\ndescription = "two targets"\nsource = "a test"\nmachine = "excavator"\n'
        "[target]\nend_points = [[0.3, 1.5], [-0.2, 1.7]]\n"
        '[selection]\nobjective = "w1"\nbase = 0.3\n'
    )
    options: dict[str, Any] = {"members": 8, "runs": 2, "points": 4, "simulation": {"duration": 2.0}}
    report = flexopt.report(flexopt.load_problem(str(file)), loop="default", **options)
    verdict, drawn = report.verdict, report.about
    assert verdict is not None
    assert isinstance(report.selection, Stand)
    assert isinstance(drawn, Stand)
    assert verdict.place not in ("", STAY, "candidate 1")
    place = next(each for each in verdict.places if each.name == verdict.place)
    held = np.array([[*each.evaluation.base, *each.evaluation.posture] for each in drawn.places])
    np.testing.assert_array_equal(held, np.hstack([place.base, place.posture]))
    w1 = [flexopt.evaluate(report.machine, q, base=b).w[0] for b, q in zip(place.base, place.posture, strict=True)]
    np.testing.assert_allclose(drawn.V, w1, rtol=1e-9, atol=1e-15)
    assert drawn.worth == drawn.V.min() < report.selection.worth
    run = report.loops["worst target"].run
    assert run.base[0].tolist() == drawn.base.tolist()
    page = Parsed(page_text(report))
    words = f"Chosen: {verdict.place}, which the verdict is about; candidate 1 has the best w1."
    assert [text.count(words) for _, text in page.all("figcaption")].count(1) == 1
    assert any("At target 1, the worst by w1" in text for _, text in page.all("figcaption"))
    said = " ".join(text for _, text in page.all("p"))
    assert f"Candidate 1 is worth {study_page.number(report.selection.worth)}" in said
    # What is told of its measures is of the stand that is drawn.
    told, others = ([study_page.sentence(each) for each in stand.remarks] for stand in (drawn, report.selection))
    assert told
    assert all(each in said for each in told)
    assert set(others) - set(told)
    assert not any(each in said for each in set(others) - set(told) - {study_page.sentence(report.selection.left_open)})
    assert drawn.plot().get_suptitle().endswith(f"; candidate {drawn.number}")
    cells = {text for _, text in page.all("td")}
    assert f"{drawn.base[0]:.4f}" in cells
    assert f"{report.selection.base[0]:.4f}" not in cells


@pytest.mark.long
def test_the_box_says_the_verdicts_own_numbers(judged: flexopt.Report) -> None:
    verdict = judged.verdict
    assert verdict is not None
    assert verdict.word == "move"
    page = Parsed(page_text(judged))
    (attributes, text), *others = page.all("section")
    assert others == []
    assert attributes["class"] == "box move"
    stay, place = (next(p for p in verdict.places if p.name == name) for name in (STAY, verdict.place))
    assert f"Move to {verdict.place}" in text
    assert study_page.with_minus(verdict.reason)[1:] in text
    told = [float(number["value"] or "") for number, _ in page.all("data", "section")]
    expected = [*place.base, *place.posture, place.drive]
    for band, end in (("decay", "least"), ("settling", "greatest"), ("allowed_gain", "least"), ("delay_margin", "least"),
                      ("swing", "greatest")):  # fmt: skip
        expected += [getattr(getattr(each, band), end) for each in (stay, place)]
    assert told == pytest.approx(expected, rel=0, abs=0, nan_ok=True)
    # And what is read is the number, in the unit beside it.
    factors = {"ms": 1e-3, "mrad": 1e-3}
    for (number, _), read in zip(page.all("data", "dl"), [text for _, text in page.all("data", "dl")], strict=True):
        value, (shown, *unit) = float(number["value"] or ""), read.split()
        if value == value and shown != "no":
            assert float(shown.replace("−", "-")) * factors.get((*unit, "")[0], 1.0) == pytest.approx(value, rel=5e-4)


def test_every_place_is_beside_the_others(judged: flexopt.Report) -> None:
    verdict = judged.verdict
    assert verdict is not None
    words = Parsed(page_text(judged)).all("main")[0][1]
    assert all(place.name in words for place in verdict.places)
    assert "stiffness times 0.5 to 2" in words
    assert verdict.rule in words
    # Numbers with their unit are right-aligned, on one line, and so is what stands for one that there is not.
    for told in ("[^< ]+ N m", "grows", "none"):
        assert set(re.findall(rf"<td([^>]*)>{told}</td>", page_text(judged))) == {' class="number"'}
    assert not re.search(r"(?<![\w(])-\d", words)
    figure = verdict.plot()
    assert [axes.get_xlabel().split(" (")[0] for axes in figure.axes] == [
        "decay", "settling time", "allowed Kp", "delay margin", "base swing, move of 0.1 m",
    ]  # fmt: skip
    assert [text.get_text() for text in figure.axes[0].texts if text.get_ha() == "right"][-len(verdict.places) :] == [
        place.name for place in verdict.places
    ]
    bars = [line.get_xdata() for line in figure.axes[0].get_lines() if line.get_linewidth() == 7]
    for bar, place in zip(bars, verdict.places, strict=True):
        assert bar == pytest.approx([place.decay.least, place.decay.greatest])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"base": 0.0}, "give its numbers in a [loop]"),
        ({}, "give that as base"),
    ],
)
def test_no_verdict_says_what_to_give(given: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Of words alone.
    monkeypatch.setattr("flexopt.study.page._png", lambda figure: "")
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), starts=2, **given)
    report = flexopt.report(problem, simulation={"duration": 0.5, "kp": 1e4, "kv": 1e3}, points=3)
    assert report.verdict is None
    assert words in report.no_verdict
    ((attributes, text),) = Parsed(report_html(report)).all("section")
    assert attributes["class"] == "box none"
    assert text == f"Does it pay to move? No verdict {' '.join(report.no_verdict.split())}"
    assert report.to_dict()["no_verdict"] == report.no_verdict


@pytest.mark.long
def test_several_targets(path: Path) -> None:
    """Every shipped kind of problem has a page, headings in order, every picture with words, every table in a box."""
    page, document = Parsed(path.read_text(encoding="utf-8")), json.loads((path.parent / "report.json").read_text())
    levels = [int(name[1]) for name, *_ in page.elements if re.fullmatch("h[1-6]", name)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert all(attributes["alt"] for attributes, _ in page.all("img"))
    assert all(around[-1] == "div" for name, _, _, around in page.elements if name == "table")
    marks = [attributes["id"] for name, attributes, *_ in page.elements if attributes.get("id")]
    assert len(marks) == len(set(marks))
    places = document["selection"].get("places")
    if places is not None:
        assert "give its numbers in a [loop]" in document["no_verdict"]
        worst = document["selection"]["worst"]
        words = page.all("main")[0][1]
        assert f"target {worst + 1}" in words
        assert "the worst" in words
        assert list(document["loops"]) == ["worst target"]
        assert document["loops"]["worst target"]["run"]["verdict"] in ("converges", "grows", "undecided")
        # The loop is that of the configuration at that target.
        assert document["mode_shares"].keys() == {"worst target"}


@pytest.mark.long
def test_many_constraints_fold(crowded: flexopt.Report) -> None:
    page = Parsed(page_text(crowded))
    best = crowded.selection.best
    named = [name for name in best.constraints if name.startswith("clearance")]
    folded = {text for _, text in page.all("th", "details")}
    shown = {text for _, text in page.all("th")} - folded
    near = [name for name in named if name in shown]
    assert len(near) == 3
    assert set(named) - set(near) <= folded
    compared = crowded.selection.candidates[:6]

    def room(name: str) -> float:
        return min(each.constraints[name].value - each.constraints[name].lower for each in compared)

    assert max(map(room, near)) <= min(room(name) for name in named if name not in near)


@pytest.mark.long("crowded")
@pytest.mark.parametrize("name", ["judged", "crowded"])
def test_candidates_without_a_column_of_constraints_are_counted(name: str, request: pytest.FixtureRequest) -> None:
    report = request.getfixturevalue(name)
    page = Parsed(page_text(report))
    columns = {text for _, text in page.all("th", "thead") if re.fullmatch(r"candidate \d+", text)}
    told = re.search(r"(\d+) more candidates? keeps? within them", " ".join(text for _, text in page.all("p")))
    assert (told is None) == (name == "judged")
    assert len(columns) + (int(told[1]) if told else 0) == len(report.selection.candidates)


@pytest.mark.long("crowded-True")
@pytest.mark.parametrize(("name", "followed"), [("judged", False), ("crowded", True)])
def test_a_map_of_followed_postures_says_so(name: str, followed: bool, request: pytest.FixtureRequest) -> None:
    report = request.getfixturevalue(name)
    words = " ".join(text for _, text in Parsed(page_text(report)).all("p"))
    assert ("another posture may still do" in words) == followed
    # Only marks that are there are told of.
    for mark, named in (("chosen", "tar: the chosen"), ("present", "ing: the present"), ("end-point", "ross: the end")):
        assert (named in words) == (mark in report.marks)


@pytest.mark.long("crowded")
@pytest.mark.parametrize("name", ["judged", "crowded"])
def test_what_the_command_says_of_a_choice_is_on_the_page(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of words alone.
    monkeypatch.setattr(study_page, "_png", lambda figure: "")
    report: flexopt.Report = request.getfixturevalue(name)
    worth = report.selection.best.objective if isinstance(report.selection, Selection) else report.selection.worth
    # One sentence at least: the better end of a climb that could not be verified.
    left = dataclasses.replace(report.selection, unverified=worth + 1.0)
    words = Parsed(report_html(dataclasses.replace(report, selection=left))).all("main")[0][1]
    assert left.remarks
    # Of another than the chosen one they stand in one sentence, which begins with whose they are.
    assert all(study_page.with_minus(remark)[1:] in words for remark in left.remarks)
    assert all(f"\n  {sentence}\n" in f"{left!r}\n" for sentence in left.remarks)


def test_nothing_is_minus_zero() -> None:
    assert [study_page.number(value) for value in (-0.0, 0.0, -1.5)] == ["0", "0", "−1.5"]


def test_negative_numbers_have_a_minus_sign() -> None:
    """In sentences, too; hyphens of names, ranges and dates stay."""
    told = "decay -0.07/s at (-1, -.5), 2e-05 of it; truck-crane, tip-over, arm-2, 2024-01-02, 3-4"
    assert study_page.sentence(told) == (
        "Decay −0.07/s at (−1, −.5), 2e−05 of it; truck-crane, tip-over, arm-2, 2024-01-02, 3-4."
    )
    assert study_page.sentence("") == ""


def test_columns_say_what_they_hold() -> None:
    """Words in place of a number stand right as numbers do; words that begin with a digit stay words."""
    source = '{% from "foundation/templates/pieces.html" import table %}{{ table(given) }}'
    given = (["a", OfNumbers("b"), "c <"], [["1", "grows", "2 of 3"], ["2", "−1.5 N m", "4"]])
    found = Parsed(_environment().from_string(source).render(given=given))
    assert [(dict(each)["class"], text) for each, text in found.all("td") if each] == [
        ("number", "grows"), ("number", "−1.5 N m"),
    ]  # fmt: skip
    assert [text for each, text in found.all("th") if each.get("class") == "number"] == ["b"]


@pytest.mark.needs("chromium")
def test_long_names_leave_their_numbers_in_sight(chromium: Browser, tmp_path: Path) -> None:
    """Constraints at corners of what is uncertain: names wrap, what is allowed and the numbers stay on a line."""
    named = "clearance of beams (start) from the assumed ground where base.stiffness.y is 1.56e+06 N/m, "
    name = f"{named}base.stiffness.rotation is 3.208e+06 N m/rad and payload.mass is 700 kg"
    source = '{% from "foundation/templates/pieces.html" import table %}{{ table(given) }}'
    header = ["constraint", "allowed", *(OfNumbers(f"candidate {k}") for k in range(1, 5))]
    given = (header, [[text, "at least 0.030154 sin²", *["−0.00031664"] * 4] for text in ("tool angle", name)])
    styles = (Path(study_page.__file__).parents[1] / "foundation/templates/page.css").read_text()
    page_file, cell = tmp_path / "long.html", tmp_path / "cell.html"
    table = _environment().from_string(source).render(given=given)
    page_file.write_text(f"<!doctype html><meta charset=utf-8><style>{styles}</style>{table}")
    rows = [("size", "1", ""), (name, "0.0123456", "m")]
    shown = render("foundation/templates/result.html", title="Candidate", rows=rows, blocks=[])
    cell.write_text(f"<!doctype html><meta charset=utf-8><style>body {{ width: 900px }}</style>{shown}")
    lines = """(each) => {
        const range = document.createRange();
        range.selectNodeContents(each);
        return new Set([...range.getClientRects()].map((line) => line.top)).size;
    }"""
    for path in (page_file, cell):
        with page_of(chromium, path) as page:
            box = ".scroll" if path == page_file else "table"
            assert (
                page.evaluate(f"(({{scrollWidth: a, clientWidth: b}}) => a - b)(document.querySelector('{box}'))") <= 0
            )
            assert max(page.evaluate(f"[...document.querySelectorAll('td:not(:empty)')].map({lines})")) == 1
            assert max(page.evaluate(f"[...document.querySelectorAll('tbody th')].map({lines})")) > 1


@pytest.mark.needs("chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits(path: Path, scheme: str, chromium: Browser) -> None:
    for width in (400, 1280):
        with page_of(chromium, path, viewport={"width": width, "height": 900}, color_scheme=scheme) as page:
            wide_tables(page, width)
            page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true })")
            assert wide_tables(page, width) > 0 or width > 400
            ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
            assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
            assert page.evaluate(GROUNDS) == [scheme]
            # No option of the shell goes on in the next line.
            of_shell = page.evaluate("[...document.querySelectorAll('.option')].map((e) => e.getClientRects().length)")
            assert set(of_shell) == {1}
            plain = "[...document.querySelectorAll('p')].filter((e) => /(^| )--[a-z]/.test(e.textContent))"
            assert page.evaluate(f"{plain}.every((e) => e.querySelector('.option'))")


@pytest.mark.needs("chromium")
def test_on_paper_nothing_is_folded_or_cut(path: Path, chromium: Browser) -> None:
    with page_of(chromium, path, viewport={"width": PAPER, "height": 1000}) as page:
        hidden = (
            "[...document.querySelectorAll('details > :not(summary)')].filter((each) => !each.checkVisibility()).length"
        )
        assert page.evaluate(hidden) > 0
        page.emulate_media(media="print", color_scheme="dark")
        # In the present browser by the stylesheet alone, in older ones by the page's script.
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        # What is shown again is laid out with the next frame.
        shown = hidden.replace("checkVisibility()", "checkVisibility({ contentVisibilityAuto: true })")
        page.wait_for_function(f"{shown} === 0")
        assert page.evaluate(f"{SHOWN}.every((each) => each.getBoundingClientRect().height > 20)")
        assert page.evaluate(f"{SHOWN}.length * 2 === document.images.length")
        on_paper(page, PAPER)
        cut = "[...document.querySelectorAll('.scroll')].map((e) => e.scrollWidth - e.clientWidth)"
        assert max(page.evaluate(cut)) <= 1
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert page.evaluate(GROUNDS) == ["light"]
        page.evaluate("window.dispatchEvent(new Event('afterprint'))")
        assert page.evaluate("document.querySelectorAll('details[open]').length") == 0


@pytest.mark.needs("chromium")
def test_paper_is_light_where_the_screen_is_dark(path: Path, chromium: Browser) -> None:
    with page_of(chromium, path, color_scheme="dark") as page:
        printed = pypdf.PdfReader(io.BytesIO(page.pdf(format="A4", print_background=True)))
    corners = [each.image.convert("L").getpixel((1, 1)) for sheet in printed.pages for each in sheet.images]
    assert len(corners) > 5
    assert min(corners) > 250


@pytest.mark.needs("chromium")
def test_keys_choose_the_picture(path: Path, chromium: Browser) -> None:
    with page_of(chromium, path) as page:
        shown = "[...document.querySelectorAll('.chooser figure')].filter((e) => e.checkVisibility() && e.parentElement.querySelector('[name=map]')).map((e) => e.textContent)"
        first = page.evaluate(shown)
        assert first == ["Mode 1: frequency."]
        for _ in range(60):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.name") == "map":
                break
        assert page.evaluate("document.activeElement.id") == "map-1"
        outline = "getComputedStyle(document.activeElement.nextElementSibling).outlineStyle"
        assert page.evaluate(outline) == "solid"
        page.keyboard.press("ArrowRight")
        assert page.evaluate(shown) == ["Mode 2: frequency."]
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("ArrowLeft")
        last = page.locator("label[for^=map-]").last.inner_text()
        assert page.evaluate(shown) == [f"{last[0].upper()}{last[1:]}."]
        page.locator("label[for=map-1]").click()
        assert page.evaluate(shown) == first


def luminance(color: str) -> float:
    """Of sRGB, as WCAG 2.2 defines it."""
    parts = [int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    r, g, b = (x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_text_can_be_read_in_both_themes() -> None:
    css = render("foundation/templates/page.css")
    light, dark = (
        dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block)) for block in re.findall(r":root {(.*?)}", css, re.S)
    )
    used = set(re.findall(r"[^-]color: var\(--(\w+)\)", css))
    assert used == {"text", "muted", "good", "bad", "warn", "page"}
    for theme in (light, dark):
        for ground in ("page", "panel"):
            for name in used - {"page"}:
                assert contrast(theme[name], theme[ground]) >= 4.5, (name, ground)
        # The chosen label of a chooser, and what only marks: borders, the outline of what has the focus.
        assert contrast(theme["page"], theme["text"]) >= 4.5
        for name in ("present", "chosen", "focus"):
            assert contrast(theme[name], theme["panel"]) >= 3.0, name
    assert light.keys() == dark.keys()


@pytest.mark.needs("chromium")
@pytest.mark.long
def test_pdf(judged: flexopt.Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = page_text(judged)
    monkeypatch.setattr(report_page, "report_html", lambda _: text)
    judged.to_pdf(tmp_path / "report.pdf")
    data = (tmp_path / "report.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    pages = pypdf.PdfReader(io.BytesIO(data)).pages
    text = " ".join(" ".join(page.extract_text() for page in pages).split())
    # Three pictures of the choice and the loops take half a page each at least.
    assert len(pages) >= 3
    for heading in ("Does it pay to move?", "The choice", "The closed loop", "Modes at rest", "The machine: excavator"):
        assert heading in text, heading
    # What is folded on the screen.
    assert "CANNOT TELL: all else" in text


@pytest.mark.needs("chromium")
def test_a_verdict_alone_is_printed(judged: flexopt.Report, tmp_path: Path) -> None:
    assert judged.verdict is not None
    judged.verdict.to_pdf(tmp_path / "verdict.pdf")
    text = " ".join(page.extract_text() for page in pypdf.PdfReader(tmp_path / "verdict.pdf").pages)
    assert "Does it pay to move?" in text
    # What is folded on the screen.
    assert "CANNOT TELL: all else" in " ".join(text.split())


@pytest.mark.needs("chromium")
def test_the_page_of_a_verdict_fits(judged: flexopt.Report, tmp_path: Path, chromium: Browser) -> None:
    """On a phone, where its table scrolls in its box, and on paper, where none is cut."""
    assert judged.verdict is not None
    judged.verdict.to_html(tmp_path / "verdict.html")
    for width in (400, PAPER):
        with page_of(chromium, tmp_path / "verdict.html", viewport={"width": width, "height": 900}) as page:
            page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true })")
            assert wide_tables(page, width) > 0 or width > 400
            if width == PAPER:
                on_paper(page, width)


@pytest.fixture
def no_browser(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(printing, "NAMES", ("no-such-browser",))
    monkeypatch.setattr(printing, "MAC", ())
    monkeypatch.setattr(printing, "WINDOWS", ())
    return


@pytest.mark.usefixtures("no_browser")
def test_without_a_browser_one_error_before_the_work(capsys: Any, tmp_path: Path) -> None:
    for command in ("report", "verdict"):
        outcome = Command(capsys, tmp_path)(command, "article", "--pdf", str(tmp_path / "page.pdf"))
        assert outcome.code == 2
        assert "install Chromium, Google Chrome or Microsoft Edge" in outcome.stderr
    outcome = Command(capsys, tmp_path)("report", "article", "--pdf", "report.txt")
    assert outcome.code == 2
    assert "must end in .pdf" in outcome.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_browser_that_prints_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "chromium"
    program.write_text("#!/bin/sh\necho no display >&2\nexit 7\n")
    program.chmod(0o755)
    monkeypatch.setattr(printing, "find_browser", lambda: str(program))
    with pytest.raises(flexopt.FlexoptError, match=r"printed no PDF \(exit code 7, no display\)"):
        printing.printed("<p>page</p>")


@pytest.mark.long
def test_verdict_command_writes_the_page(capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = Command(capsys, tmp_path)(
        "verdict", "article", "--loop", "kp=1e4", "--loop", "kv=1e3", "--members", "4", "--runs", "0",
        "--html", "verdict.html", "--plot", "verdict.png", "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.stderr
    page = Parsed((tmp_path / "verdict.html").read_text(encoding="utf-8"))
    ((_, text),) = page.all("section")
    assert outcome.document["place"] in text
    assert "Verdict: article (excavator), end-point at" in page.all("title")[0][1]
    places = {place["name"]: place for place in outcome.document["places"]}
    told = {float(number["value"] or "") for number, _ in page.all("data", "dl")}
    assert places[outcome.document["place"]]["decay"]["least"] in told
    assert (tmp_path / "verdict.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_the_edge_that_a_margin_is_from_has_a_minus_sign() -> None:
    digger, posture = flexopt.load("boom-stick-bucket"), (-0.9, -1.2, -0.5)
    target = flexopt.evaluate(digger, posture).end_point
    found = flexopt.select(digger, target, base=0.0, constraints={"tip_over_margin": 0.1}, starts=1, workers=1)
    report: Any = SimpleNamespace(selection=found, about=found, verdict=None)
    assert "tip-over margin from x = −" in str(tables.constraints(report))


def test_rounding_of_a_constraint_is_no_number_of_the_page() -> None:
    """One that a candidate rests on is at its bound but for 2⁻⁵²; the document keeps it."""
    found = flexopt.select(flexopt.load("boom-stick-bucket"), (7.0, 1.0), base=0.0, starts=1, workers=1)
    value = next(iter(found.best.constraints.values()))
    noisy = dataclasses.replace(value, value=-(2.0**-52), lower=0.0, upper=float("inf"), unit="m")
    best = dataclasses.replace(found.best, constraints={"distance from keep_out[0]": noisy})
    one = dataclasses.replace(found, candidates=(best,))
    report: Any = SimpleNamespace(selection=one, about=one, verdict=None)
    told = tables.constraints(report)
    assert told is not None
    assert told.near[1] == [["distance from keep_out[0]", "at least 0 m", "0"]]
    assert report.selection.to_dict()["candidates"][0]["constraints"]["distance from keep_out[0]"]["value"] == -(
        2.0**-52
    )


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_an_asked_margin_of_joints_has_a_row_for_each(margin: float) -> None:
    digger = flexopt.load("boom-stick-bucket")
    found = flexopt.select(digger, (7.0, 1.0), base=0.0, constraints={"joint_margin": margin}, starts=1, workers=1)
    told = tables.constraints(SimpleNamespace(selection=found, about=found, verdict=None))  # type: ignore[arg-type]
    assert told is not None
    rows = {name: values for name, *values in told.near[1]}
    for joint, q, (low, high) in zip(digger.joints, found.best.evaluation.posture, digger.limits, strict=True):
        allowed, room = rows[f"joint margin of {joint}"]
        assert allowed == f"at least {margin:g} rad"
        assert float(room) == pytest.approx(min(q - low, high - q), abs=5e-4)


def test_the_nearest_constraints_are_told_once_and_those_of_where_one_goes() -> None:
    """At corners of what is uncertain a clearance has rows of its own; the chosen candidate's nearest is another's."""
    walls = [
        {"name": name, "kind": "box", "center": center, "size": [0.5, 1.0]}
        for name, center in (("wall", [9.5, 2.0]), ("roof", [4.0, 7.5]))
    ]
    asked = {
        "clearance": {"distance": 0.1, "obstacles": walls},
        "within": [{"of": "payload.mass", "value": (0.0, 500.0)}],
    }
    machine = flexopt.load("boom-stick-bucket")
    found = flexopt.select(machine, (7.0, 1.0), base=0.0, gravity=True, constraints=asked, starts=3)
    rows = [name for name in found.best.constraints if name.startswith("clearance")]
    assert len(rows) > tables.MANY
    pairs = list(dict.fromkeys(name.split(WHERE)[0] for name in rows))
    assert len(rows) >= 2 * len(pairs)
    assert len(pairs) > 4

    def with_room(room: dict[str, float]) -> SimpleNamespace:
        """By pair, alike at all its corners but for what tells them apart."""
        kept = {
            name: dataclasses.replace(
                value, value=value.lower + room.get(name.split(WHERE)[0], 9.0) + 1e-6 * rows.index(name)
            )
            for name, value in found.best.constraints.items()
            if name in rows
        }
        return SimpleNamespace(constraints=kept)

    # Of one the first three pairs are the nearest of all, each at one of its corners; of the other the last is.
    candidates = [with_room(dict(zip(pairs, (0.1, 0.2, 0.3), strict=False))), with_room({pairs[-1]: 0.4})]
    selection: Any = Selection.__new__(Selection)
    for field, value in (("candidates", candidates), ("problem", found.problem)):
        object.__setattr__(selection, field, value)
    for k, last in ((0, []), (1, pairs[-1:])):
        verdict = SimpleNamespace(place=f"candidate {k + 1}")
        made = tables.constraints(SimpleNamespace(about=selection, selection=selection, verdict=verdict))  # type: ignore[arg-type]
        assert made is not None
        assert [name.replace("−", "-").split(WHERE)[0] for name, *_ in made.near[1]] == pairs[:3] + last
    for k in range(min(3, len(found.candidates))):
        report: Any = SimpleNamespace(selection=found, about=found, verdict=SimpleNamespace(place=f"candidate {k + 1}"))
        told = tables.constraints(report)
        assert told is not None
        near = [name for name, *_ in told.near[1] if name.startswith("clearance")]
        own = found.candidates[k].constraints
        assert min(rows, key=lambda name, own=own: own[name].nearness) in [name.replace("−", "-") for name in near]
        assert len(near) <= 4
        assert told.told.endswith("or at other corners")


def test_the_caption_says_where_the_drawn_present_one_is() -> None:
    """A present posture beside the target is drawn with the others, and none where there is none."""
    machine, posture = flexopt.load("excavator"), (0.9, -2.4)
    off = float(np.linalg.norm(flexopt.evaluate(machine, posture, base=0.0).end_point - np.array([0.0, 1.6])))
    held = flexopt.select(machine, (0.0, 1.6), base=0.0, posture=posture, starts=2, seed=1)
    reached = dataclasses.replace(held, initial=held.best.evaluation)
    captions = [
        report_page._caption(SimpleNamespace(about=about))
        for about in (held, reached, dataclasses.replace(held, initial=None))
    ]
    assert "configuration and in the present one (holds the end-point at " in captions[0]
    assert f"not at the target but {off:.3g} m away), and its measures" in captions[0]
    assert "configuration and in the present one, and its measures" in captions[1]
    assert "configuration, and its measures" in captions[2]
