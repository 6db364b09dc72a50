"""The article computed again: its printed numbers within their bars, each verdict from numbers, files that stand alone."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import flexopt
from flexopt.article import gaps, pictures
from flexopt.article import page as article_page
from flexopt.article.gaps import RIGID_MARGIN
from flexopt.foundation.palette import PALETTES
from flexopt.study import page
from tests.cli.command import strict_json
from tests.plotting.looking import faults, without_pictures

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")


def finding(group, key):
    return next(f for f in group if f.key == key)


def test_margins_of_table_2(result):
    inferred = result.table.inferred
    assert inferred.interval[0] < inferred.kr < inferred.interval[1]
    assert inferred.kr == pytest.approx(4.97e5, rel=1e-3)
    rows = result.table.rows
    for row in rows:
        assert abs(row.epsilon_inferred - row.printed_epsilon) < 5e-4
        assert abs(row.evaluation.epsilon_max - row.printed_epsilon) < 5e-4
    by_reading = {row.reading: row for row in rows}
    assert by_reading[inferred.reading].epsilon_inferred == pytest.approx(0.2869, abs=1e-10)
    # Only the point of the printed w_i gives the printed ε_max to its last digit, too.
    assert round(by_reading["workspace point (1.5575, 1.0870) m"].epsilon_inferred, 4) == 0.3826
    assert round(by_reading["printed workspace point (1.32687, 1.0870) m"].epsilon_inferred, 4) == 0.3824
    # The second gain that suits posture A does not suit B.
    assert inferred.other > 2e6
    assert abs(inferred.other_epsilon_b - 0.3826) > 1e-3


def test_the_map_of_gains_says_whose_decay_it_draws(result):
    """Colours and crosses are of the loop itself, exact between the samples; the runs are the integrator's."""
    caption = article_page.CAPTIONS["gains"]
    assert caption.index("exact between the samples") < caption.index("nonlinear runs by RK4")
    assert len(result.gains.disagreements) > len(result.gains.own_disagreements)


def test_the_largest_margin_is_told_as_the_largest(result):
    sentence = finding(result.contradictions, "maximum of ε_max").sentence
    assert "this most is below 0.3827, and above sin(π/8)" in sentence


def test_figures_as_files_of_a_slides_size(result, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        type(result), "figures", lambda _, **look: asked.append(look) or {"figure5": Figure(figsize=(10.0, 5.625))}
    )
    (written,) = result.write_figures(tmp_path / "new", form="png", theme="dark", size="slide")
    assert asked == [{"theme": "dark", "size": "slide"}]
    assert written == tmp_path / "new" / "figure5.png"
    with Image.open(written) as image:
        assert image.size == (1920, 1080)


def test_mean_frequencies(result):
    f = result.frequencies
    for values in f.means.values():
        np.testing.assert_allclose(values, f.printed, rtol=5e-3)
    np.testing.assert_allclose(f.means["over the area, 5 cm grid"], [3.0756, 13.1399, 22.4390], rtol=1e-4)


def test_verdicts_are_computed(result):
    verdicts = {f.key: f.holds for f in (*result.contradictions, *result.claims)}
    assert all(type(verdict) is bool for verdict in verdicts.values())
    assert verdicts == dict.fromkeys(
        ("posture B", "union", "definiteness", "gain", "concavity", "B as an optimum", "passivity",
         "stable by configuration", "integration step"),
        False,
    ) | dict.fromkeys(
        ("maximum of ε_max", "same shape", "in phase", "features", "better convergence", "base adjustment", "excitation", "higher gain",
         "robust controller"),
        True,
    )  # fmt: skip
    for f in (*result.contradictions, *result.claims):
        assert f.quote
        assert f.where
        assert f.sentence.endswith(".")
        assert f.numbers


def test_posture_b(result):
    worst = finding(result.contradictions, "posture B").numbers["deviation"]
    assert worst["printed workspace point (1.32687, 1.0870) m"] > 2
    assert abs(worst["workspace point (1.5575, 1.0870) m"]) < 4e-3


def test_quotations_are_the_articles_words(result):
    """Every part of each, letter by letter, in the sentences that were copied from the article's text."""
    copied = (Path(__file__).parent / "quotations.txt").read_text(encoding="utf-8")
    parts = [part for f in (*result.contradictions, *result.claims) for part in f.quote.split(" … ")]
    parts += re.findall('"(.*?)"', " ".join(gaps.__doc__.split()))
    assert len(parts) > len(result.contradictions) + len(result.claims)
    assert [part for part in parts if part not in copied] == []


def test_maximum(result):
    """On Fig. 8's own line, elbow up, the printed bound holds; what exceeds it lies elsewhere."""
    found = finding(result.contradictions, "maximum of ε_max")
    assert set(found.numbers["largest"]) == {f"{c}, elbow {e}" for c, e in result.curves}
    machine, gain = flexopt.load("excavator"), result.table.inferred.kr
    for name, largest in found.numbers["largest"].items():
        control, elbow = name.split(", elbow ")
        line = result.curves[control, elbow]
        k = int(np.nanargmax(line.epsilon_max))
        e = flexopt.evaluate(machine, line.posture[:, k], control=control, gain=gain)
        assert e.epsilon_max == pytest.approx(largest, rel=1e-9)
        assert e.end_point[1] - e.skeleton[1, 1] == pytest.approx(1.0870, abs=1e-9)
        assert math.sin(math.pi / 8) < largest
        assert (largest < 0.3827) == (elbow == "up")
    assert found.numbers["largest_in_workspace"] > 0.3827


def test_union_is_no_in_phase_region(result):
    n = finding(result.contradictions, "union").numbers
    assert n["union"] + n["intersection"] == pytest.approx(n["mode_1"] + n["mode_2"], abs=1e-12)
    assert n["union_out_of_phase"] > 0.5
    regions = result.maps["inverse"].array("in_phase")
    assert np.nanmean(regions[0] * regions[1]) == pytest.approx(n["intersection"])


def test_gain(result):
    numbers = finding(result.contradictions, "gain").numbers
    machine, kr = flexopt.load("excavator"), result.table.inferred.kr
    posture = result.gaps.posture[0]
    step = 1e-4 * kr
    high, low = (flexopt.evaluate(machine, posture, gain=kr + s).epsilon_max for s in (step, -step))
    assert numbers["derivative"]["A"] == pytest.approx((high - low) / (2 * step), rel=1e-6)
    assert numbers["relative_derivative"]["A"] == pytest.approx(-0.208, abs=1e-3)


def test_maxima_along_the_height(result):
    maxima = finding(result.contradictions, "concavity").numbers["maxima"]
    expected = {
        "inverse, elbow up": [-2.03, 2.15],
        "inverse, elbow down": [-1.79, -0.41, 2.01, 2.75],
        "transpose, elbow up": [-2.21, 1.45],
        "transpose, elbow down": [-1.25, -0.15, 2.09],
    }
    for name, xs in expected.items():
        np.testing.assert_allclose(maxima[name], xs, atol=0.012)


def test_slope_at_b(result):
    numbers = finding(result.contradictions, "B as an optimum").numbers
    machine, origin = flexopt.load("excavator"), flexopt.evaluate(flexopt.load("excavator"), [0.5, -1.0]).skeleton[:, 1]
    for name, x in (("B, printed point", 1.32687), ("B, point of its measures", 1.5575)):
        w = []
        for step in (-1e-4, 1e-4):
            posture = flexopt.inverse_kinematics(machine, np.add(origin, [x + step, 1.087]), elbow="up")[0]
            w.append(flexopt.evaluate(machine, posture).w[0])
        assert numbers["slope"][name] == pytest.approx((w[1] - w[0]) / 2e-4, rel=1e-4)
    assert numbers["maximum"] == pytest.approx(2.145, abs=2e-3)


def test_claims(result):
    shape = finding(result.claims, "same shape").numbers
    assert set(shape["rank_correlation"]) == {"transpose, elbow up", "inverse, elbow up"}
    assert all(0.84 < value < 0.93 for value in shape["rank_correlation"].values())
    assert max(shape["epsilon_max_lost_by_choosing_w1"].values()) < 6e-3
    phase = finding(result.claims, "in phase").numbers
    assert phase["first_two"] == pytest.approx(0.372, abs=0.01)
    assert phase["first_two_strict"] == pytest.approx(0.11, abs=0.01)
    passivity = finding(result.claims, "passivity").numbers
    assert passivity["fraction_indefinite"]["transpose"] == 0.0
    assert passivity["fraction_indefinite"]["inverse"] == pytest.approx(0.557, abs=0.02)
    assert max(passivity["optima_other_w"]) < -1e-6
    assert all(values[0] > 0.7 for values in finding(result.claims, "features").numbers["rank_correlation"].values())


def test_gaps(result):
    g = result.gaps
    assert g.nu_gap.shape == g.gap.shape == g.epsilon_max.shape == (len(g.names), len(g.factors))
    assert np.isfinite(g.nu_gap).all()
    assert (g.gap >= g.nu_gap - 1e-8).all()
    assert (g.nu_gap[:, 0] > 0.99).all()
    assert (np.diff(g.nu_gap, axis=1) < 0).all()
    assert g.within[0] == 0
    assert g.within[-1] == len(g.names)
    assert g.within == tuple((g.nu_gap < RIGID_MARGIN).sum(axis=0))
    assert not g.holds_at_own_damping
    assert "fails as a number" in g.sentence
    assert "It takes 100 times the damping" in g.sentence
    assert g.epsilon_max[0, 0] == pytest.approx(0.2869, abs=1e-9)


def test_progress(run):
    total = run.stages[0][1]
    assert [done for done, _ in run.stages] == list(range(1, total + 1))


def test_json(run, result, files):
    document = strict_json(files[1].read_text(encoding="utf-8"))
    assert strict_json(run.stdout) == document
    assert document == json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert set(document) == {
        "table2", "mean_frequencies_hz", "maps", "contradictions", "claims", "closed_loops", "gains", "gaps", "provenance",
    }  # fmt: skip
    for row in document["table2"]["rows"]:
        assert len(row["printed_w"]) == len(row["deviation"]) == 3
        assert row["epsilon_max_deviation"] == pytest.approx(
            row["epsilon_max_at_inferred_gain"] - row["printed_epsilon_max"], abs=1e-15
        )
    assert document["provenance"]["machine"] == "excavator"
    assert "casadi" in document["provenance"]


def test_page_stands_alone(result, files):
    page = files[0].read_text(encoding="utf-8")
    assert "http" not in without_pictures(page)
    assert not re.search(r"<(link|script|iframe|object)\b|@import|url\(", page)
    sources = re.findall(r'src="([^"]{0,30})', page)
    assert len(sources) == 2 * 9
    assert all(source.startswith("data:image/png;base64,iVBOR") for source in sources)
    text = page.replace("&#x27;", "'").replace("&lt;", "<").replace("&gt;", ">")
    for f in (*result.contradictions, *result.claims):
        assert f.sentence in text
        assert f.quote in text
    for sentence in (result.gaps.sentence, result.loops.sentence, result.gains.sentence):
        assert sentence in text
    for row in result.gains.borders:
        assert row.text in text
    assert "of w_i (computed − printed) / printed, + where it is larger in magnitude than printed" in text
    for number in ("0.2869", "0.3826", "3.0872", "13.1392", "22.4394", "+14.45%", "+244.62%", "deviates by +245 %"):
        assert number in text


@pytest.mark.long
def test_folder_is_kept(run, result, files, tmp_path, monkeypatch):
    """And what is written once more is the same; of its pictures the last is drawn again."""
    again = page.picture(lambda theme: pictures.plot_gaps(result.gaps, theme=theme), "gaps")
    assert again[:3] == run.pictures["gaps"][:3]
    monkeypatch.setattr(article_page, "pictures", lambda draw: run.pictures)
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "report.json").write_text("old")
    result.write(tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert (tmp_path / "report.json").read_bytes() == files[1].read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.txt", "report.html", "report.json"]
    assert (tmp_path / "report.html").read_bytes() == files[0].read_bytes()


@pytest.mark.long
def test_figures_as_files(result, tmp_path):
    with pytest.raises(flexopt.InputError, match=r"(?s)form = 'gif'.*theme = 'grey'.*size = 'poster'"):
        result.write_figures(tmp_path, form="gif", theme="grey", size="poster")
    files = result.write_figures(tmp_path / "new", form="svg", theme="dark", size="slide")
    assert sorted((tmp_path / "new").iterdir()) == sorted(files)
    assert {file.stem for file in files} == {"gains", "gaps", "figures11and12", *(f"figure{k}" for k in range(5, 11))}
    for file in files:
        assert PALETTES["dark"].page.lower() in file.read_text(encoding="utf-8").lower()


@pytest.mark.long("paper", "slide")
@pytest.mark.parametrize("size", ["screen", "paper", "slide"])
def test_no_text_of_a_figure_is_cut_or_lies_on_another(result, size):
    found = {name: faults(figure) for name, figure in result.figures(theme="light", size=size).items()}
    assert not any(found.values()), found
    assert len(found) > 8


def test_text(result):
    text = repr(result)
    for word in (
        "Table 2",
        "Mean frequencies",
        "Claims that the article itself or the numbers seem to contradict",
        "Other claims in words",
        "Closed loops",
        "The gap metric",
        "kr = 4.971e+05 N m gives",
        "w_i in 1/(kg m2)",
    ):
        assert word in text
