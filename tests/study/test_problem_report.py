"""The report on a problem carries the numbers of the calls that it is made of."""

import base64
import html
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import flexopt
from flexopt.model.tree import tree_from_dict
from flexopt.plotting.workspace import plot_quantities
from flexopt.study import page
from flexopt.study.reports.page import _placed as placed
from flexopt.study.reports.page import report_html
from flexopt.study.reports.surroundings import marks_in, surroundings
from tests.cli.command import Command
from tests.oracles.machines import heavier
from tests.oracles.spatial import in_space
from tests.plotting.looking import without_pictures

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")


def made(problem, **options):
    return flexopt.report(problem, points=9, **options)


@pytest.fixture(scope="module")
def article():
    """The article's problem with the gains of its experiment."""
    stages = []
    result = made(
        flexopt.load_problem("article"), experiment=flexopt.load_experiment("article-a"),
        progress=lambda done, total: stages.append((done, total)),
    )  # fmt: skip
    done = [done for done, _ in stages]
    assert done == sorted(set(done))
    assert {20, 40, 60, 80, 100} <= set(done)
    assert {total for _, total in stages} == {100}
    return result


def pixels(picture):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("L"))


def text_of(page):
    return html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"<style>.*?</style>", "", page, flags=re.S)))


@pytest.fixture
def words_alone(monkeypatch):
    """Pages without their pictures, which `test_files` looks at."""
    monkeypatch.setattr(page, "_png", lambda figure: "")


@pytest.mark.long
def test_choice_and_loops_are_those_of_the_calls(article):
    best, initial = article.selection.best.evaluation, article.selection.initial
    expected = flexopt.solve_problem(flexopt.load_problem("article"))
    np.testing.assert_allclose(best.posture, expected.best.evaluation.posture, atol=1e-9)
    # The present placement is given and no posture, though there is one that reaches the target from there.
    way = f"base {abs(best.base[0]):.3g} m; joints up to {abs(best.posture).max():.3g} rad from zeros, as no present posture"
    assert way in article.selection.decided_by
    assert list(article.loops) == ["present", "chosen"]
    stated = flexopt.run_experiment(flexopt.load_experiment("article-a"))
    np.testing.assert_allclose(article.loops["present"].run.error, stated.error, atol=1e-9)
    assert article.loops["present"].run.verdict == "grows"
    chosen = flexopt.simulate(
        flexopt.load("excavator"), best.posture, base=best.base, kp=1e5, kv=2e3, offset=[0.05, -0.05], duration=10.0
    )
    np.testing.assert_allclose(article.loops["chosen"].run.q, chosen.q, atol=1e-9)
    assert article.loops["chosen"].run.verdict == "converges"
    linear = flexopt.sampled_loop(flexopt.load("excavator"), initial.posture, base=initial.base)
    assert article.loops["present"].linear.growth_rate == pytest.approx(linear.growth_rate, rel=1e-9)
    held = {(row.stand, row.held): row for row in article.borders}
    assert set(held) == {(s, w) for s in ("present", "chosen") for w in ("Kv = 2000", "Kv/Kp = 0.02 s")}
    border = held["chosen", "Kv = 2000"].border
    for kp, stable in ((0.99 * border.largest, True), (1.01 * border.largest, False)):
        loop = flexopt.sampled_loop(flexopt.load("excavator"), best.posture, base=best.base, kp=kp, kv=2e3)
        assert loop.stable == stable
    assert article.notes == ()


@pytest.mark.long
@pytest.mark.parametrize("factor", [1e-7, 1.0])
def test_gains_that_converge_are_among_those_that_are_told_stable(factor: float) -> None:
    """Of machines of any size: where they are looked for follows from the loop's own gains, and is told."""
    machine = heavier(flexopt.load("excavator").to_dict(), factor)
    result = made(flexopt.build_selection(machine, (0.0, 1.6), base=0.0, starts=2), simulation={"duration": 2.0})
    kp, kv = result.simulation["kp"], result.simulation["kv"]
    for row in result.borders:
        stand = result.stands[row.stand]
        decays = flexopt.sampled_loop(machine, stand.posture, base=stand.base, kp=kp, kv=kv).stable
        assert decays == any(low < kp < high for low, high in row.border.intervals)
        assert row.border.searched == pytest.approx((1e-4 * kp, 1e4 * kp))
        assert row.text in repr(result)
    assert {row.stand for row in result.borders} == {"present", "chosen"}
    assert any(row.border.intervals for row in result.borders)
    words = text_of(report_html(result))
    assert f"from {1e-4 * kp:.4g}, as low as was looked," in words


@pytest.mark.long
def test_document(article):
    document = json.loads(json.dumps(article.to_dict(), allow_nan=False))
    machine = flexopt.load("excavator")
    assert document["machine"]["sha256"] == machine.content_hash
    assert {p["name"]: p["value"] for p in document["machine"]["parameters"]}["boom.mass"] == 766.6
    assert document["selection"]["best"]["posture"] == article.selection.best.evaluation.posture.tolist()
    assert document["map"]["marks"].keys() == {"present", "chosen"}
    assert document["loops"]["present"]["run"]["verdict"] == "grows"
    assert document["simulation"]["kp"] == [1e5]
    assert len(document["gains"]) == 4
    assert [each["name"] for each in document["selection"]["problem"]["assumed"]] == ["reach", "capsules"]
    shares = np.array(document["mode_shares"]["chosen"])
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    # The first mode is the base's rotation: its strain energy by hand.
    chosen = article.selection.best.evaluation
    v = flexopt.build_measures(machine).values(
        base=chosen.base, posture=chosen.posture, p=flexopt.build_plant(machine).parameter_values
    )
    energy = np.array([4e7, 4e7, 1.112e6]) * v["modes"].full()[:3, 0] ** 2
    np.testing.assert_allclose(shares[:, 0], energy / energy.sum())


def test_a_present_posture_beside_the_target_is_told(article):
    held = flexopt.evaluate(flexopt.load("excavator"), (0.5, -1.5))
    elsewhere = replace(article, selection=replace(article.selection, initial=held))
    x, y = held.end_point
    assert f"Present: holds the end-point at ({x:.4g}, {y:.4g}) m, not at the target but" in placed(elsewhere)[1]
    assert "Present: one of the postures that reach the target from there: none was given." in placed(article)[1]


def test_marks_are_where_the_machine_is(article):
    for name, stand in article.stands.items():
        joint, tip = stand.skeleton[:, 1], stand.skeleton[:, -1]
        np.testing.assert_allclose(article.marks[name], tip - joint, atol=1e-12)


def test_what_runs_warn_of_is_on_the_page(article, words_alone):
    """Of both once; of one with its name."""
    both, one = "a drive took more than it has", "the step is long"
    present, chosen = article.loops.values()
    loops = {"present": replace(present, run=replace(present.run, warnings=(both,))),
             "chosen": replace(chosen, run=replace(chosen.run, warnings=(both, one)))}  # fmt: skip
    assert both not in text_of(report_html(article))
    words = text_of(report_html(replace(article, loops=loops)))
    assert words.count(f"Present and chosen: {both}.") == 1
    assert words.count(f"Chosen: {one}.") == 1


@pytest.mark.parametrize("site", [0.0, 5e5])
def test_a_map_of_another_base_marks_no_configuration_of_this_one(site):
    """Of an arm whose end-points are mapped as its base stands, at coordinates of a site, too."""
    chosen = flexopt.select(flexopt.load("boom-stick-bucket"), (7.0 + site, 1.0), base=site, starts=2)
    assert chosen.initial is not None
    assert abs(chosen.initial.base - chosen.best.evaluation.base).max() > 0.1
    assert [*marks_in(chosen, surroundings(chosen, 4))] == ["chosen"]


@pytest.mark.long
def test_files(article, tmp_path):
    web, data = article.write(tmp_path / "new" / "folder")
    assert json.loads(data.read_text(encoding="utf-8")) == json.loads(json.dumps(article.to_dict()))
    markup = web.read_text(encoding="utf-8")
    assert "http" not in without_pictures(markup).replace("https://", "")
    pictures, dark = (
        re.findall(rf'class="on-{ground}(?: own)?" src="data:image/png;base64,([A-Za-z0-9+/=]+)"', markup)
        for ground in ("light", "dark")
    )
    # The map's panels come one by one, beside the choice and the runs.
    drawn = list(article.figures())
    assert drawn == ["selection", "map", "loops", "run present", "run chosen"]
    quantities = plot_quantities(article.map, marks=article.marks)
    assert len(pictures) == len(drawn) - 1 + len(quantities)
    assert len(quantities) == sum(bool(axes.get_title()) for axes in article.map.plot().axes)
    for picture in pictures:
        assert pixels(picture).std() > 5
    for light, other in zip(pictures, dark, strict=True):
        assert pixels(light).shape == pixels(other).shape
        assert pixels(light)[1, 1] == 255
        assert pixels(other)[1, 1] < 40
    words = text_of(markup)
    best = article.selection.best.evaluation
    for expected in ("The article's target", "766.6", "1.112e+06", f"{best.posture[0]:.5g}", "grows", "Kv/Kp = 0.02 s",
                     "base.rotation 96 %", "singularity margin", "at least 0.030154 sin²", "kp = 100000",
                     "Assumed (reach): the base moves by no more than 3.188 m along x"):  # fmt: skip
        assert expected in words, expected
    repr(article)


@pytest.mark.long
def test_both_grounds_take_little_more_room_than_one_in_all_colours(article):
    """And no point is off by more than anyone sees."""
    figures = {theme: article.figures(theme=theme) for theme in ("light", "dark")}
    embedded = page.pictures(lambda theme: figures[theme])
    for name, figure in figures["light"].items():
        whole = io.BytesIO()
        figure.savefig(whole, format="png", dpi=page.DOTS)
        # In Base64, as pages have them.
        assert len(embedded[name].light) + len(embedded[name].dark) < 1.2 * 4 / 3 * len(whole.getvalue())
        exact = Image.open(whole).convert("RGB")
        off = np.asarray(page.few_colours(exact).convert("RGB"), dtype=int) - np.asarray(exact, dtype=int)
        assert np.abs(off).max() <= 16


@pytest.mark.long
@pytest.mark.usefixtures("words_alone")
def test_machine_in_space():
    machine = tree_from_dict(in_space({"gravity": 9.81} | flexopt.load("excavator").to_dict()))
    asked = {"region": [[[-3.0, -1.0], [3.0, -1.0], [3.0, 1.0], [-3.0, 1.0]]]}
    problem = flexopt.build_selection(
        machine, (0.0, 1.6), base=0.0, posture=[0.9929, -2.6306], constraints=asked, starts=3
    )
    result = made(problem, simulation={"duration": 2.0, "feedback": "pid", "ki": 1e3})
    assert result.map.options["over"] == "end_point"
    # In the workspace frame, as in the plane: from the first joint, beyond the ground's and the base's four frames.
    best = result.selection.best.evaluation
    np.testing.assert_allclose(result.marks["chosen"], best.end_point - best.skeleton[[0, 2], 4], atol=1e-12)
    assert {name: loop.run.time[-1] for name, loop in result.loops.items()} == {"present": 2.0, "chosen": 2.0}
    # Borders are those of two gains.
    assert result.borders == ()
    words = text_of(report_html(result))
    assert "distance inside region" in words
    assert result.to_dict()["constraints"]["region"] is not None


@pytest.mark.long
def test_no_borders_are_told_of_rows_with_other_gains():
    """They are told by one Kv, of all rows."""
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), starts=2)
    result = made(problem, simulation={"kp": 1e4, "kv": [1e3, 2e3], "duration": 0.5})
    assert list(result.loops) == ["chosen"]
    assert result.borders == ()


@pytest.mark.long
@pytest.mark.usefixtures("words_alone")
def test_what_cannot_be_run_is_noted():
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))
    result = made(problem, simulation={"rate": 20.0, "integrator": "rk4", "substeps": 1})
    assert list(result.loops) == []
    assert len(result.notes) == 1
    assert result.notes[0].startswith("the closed loop, chosen:")
    words = text_of(report_html(result))
    assert "Note:" in words
    assert result.notes[0].split(":")[0] in words


def test_faults():
    problem = flexopt.load_problem("article")
    with pytest.raises(flexopt.InputError, match="must be a problem"):
        flexopt.report("article")
    with pytest.raises(flexopt.InputError, match="points = 1"):
        flexopt.report(problem, points=1)
    with pytest.raises(flexopt.InputError, match="must be an Experiment"):
        flexopt.report(problem, experiment="article-a")
    with pytest.raises(flexopt.InputError, match="2 faults") as caught:
        flexopt.report(problem, simulation={"posture": [0, 1], "control": "inverse"})
    assert {fault.field for fault in caught.value.faults} == {"simulation.posture", "simulation.control"}
    with pytest.raises(flexopt.InputError, match="kp"):
        flexopt.report(problem, simulation={"kp": -1.0})


@pytest.mark.long
@pytest.mark.usefixtures("words_alone")
def test_command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = Command(capsys, tmp_path)
    outcome = command(
        "report", "excavator", "--end-point", "0,1.6", "--base", "0", "--points", "5", "--duration", "1", "--kp", "1e4",
        "--out", "folder", "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.stderr
    assert outcome.document == json.loads((tmp_path / "folder" / "report.json").read_text(encoding="utf-8"))
    assert outcome.document["simulation"] == {"duration": 1.0, "kp": [1e4], "control": "inverse", "gravity": False}
    assert (tmp_path / "folder" / "report.html").exists()
    for arguments, words in (
        (("excavator",), "needs --end-point"),
        (("article", "--end-point", "0,1"), "--end-point = 0,1: goes with a machine"),
        (("article", "--points", "0"), "--points = 0"),
        (("article", "--kp", "x"), "kp"),
        (("article", "--experiment", "article"), "article"),
        (("nothing",), "nothing"),
    ):
        outcome = command("report", *arguments)
        assert outcome.code == 2
        assert words in outcome.stderr


@pytest.mark.long
def test_a_run_too_short_for_its_verdict_is_noted():
    """Next to the border of stability ten seconds do not tell; the eigenvalues do."""
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), base=0.0)
    result = made(problem, simulation={"duration": 10.0, "kp": 3200.0, "kv": 64.0})
    for name, loop in result.loops.items():
        noted = any(note.startswith(f"the closed loop, {name}: the run of 10 s") for note in result.notes)
        assert noted == (loop.run.verdict == "undecided")
        assert noted == (loop.linear.stable != (loop.run.run.word == "converges"))
    assert any("too short" in note for note in result.notes)


@pytest.mark.long
@pytest.mark.usefixtures("words_alone")
def test_the_verdict_is_that_of_the_call_and_its_loop_that_of_the_runs(capsys, tmp_path, monkeypatch):
    """With as many members as asked for; what `default` leaves out follows from the present place once, for all."""
    monkeypatch.chdir(tmp_path)
    asked = ("--loop", "default", "--members", "5", "--runs", "1")
    command = Command(capsys, tmp_path)
    document = command.json("report", "article", *asked, "--points", "3", "--out", "r")
    found = document["verdict"]
    alone = command.json("verdict", "article", *asked)
    present = flexopt.outcome(flexopt.load("excavator"), document["selection"]["initial"]["posture"], loop="default")
    assert found["settings"]["kp"] == present.settings.kp.tolist()
    numbers = {name: x for name, x in alone["settings"].items() if name != "sources"}
    assert list(document["loops"]) == ["present", "chosen"]
    for loop in document["loops"].values():
        assert {name: x for name, x in loop["run"]["loop"].items() if name != "sources"} == numbers
        assert loop["run"]["provenance"]["options"]["kp"] == numbers["kp"]
    assert found["provenance"]["options"]["members"] == 5
    assert [place["decay"] for place in found["places"]] == [place["decay"] for place in alone["places"]]


def three_targets(folder):
    (folder / "three.toml").write_text(
        """schema = 1
        name = "three"
        machine = "excavator"
        target.end_points = [[0.0, 1.6], [0.3, 1.3], [-0.3, 1.7]]
        selection = { base = [0.0], starts = 1 }
        loop = { kp = 1e4, kv = 1e3 }""",
        encoding="utf-8",
    )
    return folder / "three.toml"


@pytest.mark.long
def test_of_several_targets_the_loop_is_run_where_it_decays_slowest_too(tmp_path):
    """w1 is 0 at all of them to rounding, so that the worst by it tells nothing of the loop."""
    few = {"points": 4, "members": 2, "runs": 0, "simulation": {"duration": 2.0}}
    found = flexopt.report(flexopt.load_problem(three_targets(tmp_path)), **few)
    assert isinstance(found.about, flexopt.Stand)
    assert found.verdict is not None
    k = found.verdict.places[-1].slowest_target
    decays = [
        flexopt.outcome(found.machine, place.evaluation.posture, base=place.evaluation.base, loop={"kp": 1e4, "kv": 1e3})
        .decay for place in found.about.places
    ]  # fmt: skip
    assert k == int(np.argmin(decays))
    assert k != found.about.worst
    run = found.loops["slowest target"].run
    assert run.linear_growth_rate == pytest.approx(-min(decays), rel=1e-6)
    assert f"the loop decays slowest at target {k + 1}; it is run there, too" in report_html(found)


@pytest.mark.long
def test_runs_of_other_gains_are_not_said_to_be_of_the_verdicts_loop(tmp_path):
    problem = flexopt.load_problem(three_targets(tmp_path))
    few = {"points": 4, "members": 2, "runs": 0, "simulation": {"kp": 2e4, "kv": 1e3, "duration": 2.0}}
    found = flexopt.report(problem, **few)
    assert found.verdict is not None
    assert list(found.loops) == ["worst target"]
    assert "decays slowest at target" not in report_html(found)


@pytest.mark.long
def test_the_present_loop_is_run_in_the_posture_that_staying_is_judged_in():
    """That of the choice, which no one gave, would have the stick in the ground."""
    machine = flexopt.load("boom-stick-bucket")
    problem = flexopt.build_selection(machine, (5.0, 1.0), base=0.0, starts=1)
    loop = {"kp": 5e4, "kv": 2e4, "rate": 100.0, "drive": "torque"}
    found = flexopt.report(problem, loop=loop, points=4, members=2, runs=0, simulation={"duration": 1.0})
    stay = found.verdict.places[0]
    assert stay.name == "stay"
    assert np.abs(found.selection.initial.posture - stay.posture).max() > 1e-3
    np.testing.assert_array_equal(found.stands["present"].posture, stay.posture)
    own = flexopt.outcome(machine, stay.posture, base=0.0, loop=found.verdict.settings.fixed)
    # Of matrices that rounding tells apart.
    assert found.loops["present"].run.linear_growth_rate == pytest.approx(-own.decay, rel=1e-6)
    assert "Present: in the posture that staying is judged in." in report_html(found)
