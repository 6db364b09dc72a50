"""Every notebook runs from top to bottom, and what is kept of it is what its text says."""

import html
from pathlib import Path

import jupytext
import nbformat
import numpy as np
import pytest
from scipy.linalg import eigvalsh

import flexopt
from flexopt.study.verdicts.decision import RULE
from tests.notebooks.execution import FOLDER, executed, texts


def test_every_text_has_its_notebook_and_the_other_way_round():
    assert texts()
    assert [path.stem for path in texts()] == [path.stem for path in sorted(FOLDER.glob("*.ipynb"))]


@pytest.mark.parametrize("path", texts(), ids=lambda path: path.stem)
def test_text_and_notebook_have_the_same_cells(path: Path):
    """If not: `python -m tests.notebooks.execution NAME`."""
    kept = nbformat.read(path.with_suffix(".ipynb"), as_version=4)
    text = jupytext.read(path)
    assert [(cell.cell_type, cell.source) for cell in kept.cells] == [
        (cell.cell_type, cell.source) for cell in text.cells
    ]
    assert all(cell.execution_count for cell in kept.cells if cell.cell_type == "code")
    # Warnings of other packages name files of the machine on which it was recorded.
    outputs = [output for cell in kept.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not any("site-packages" in output.get("text", "") for output in outputs)


def kept(path: Path) -> str:
    """All outputs that are kept of a notebook, without the quotations of HTML."""
    cells = nbformat.read(path.with_suffix(".ipynb"), as_version=4).cells
    outputs = [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]
    shown = [
        text for output in outputs for text in (output.get("text", ""), output.get("data", {}).get("text/html", ""))
    ]
    return html.unescape("\n".join(shown))


def test_kept_outputs_are_of_todays_rule_and_explorer():
    """The documentation shows what is kept. If not: `python -m tests.notebooks.execution NAME`."""
    templates = Path(flexopt.__file__).parent / "explorer" / "templates"
    scripts = [(templates / name).read_text(encoding="utf-8").strip() for name in ("page.js", "map.js", "linear.js")]
    parts = {"\nprint(answer.rule)": [RULE], "flexopt.explore(": scripts}
    for call, told in parts.items():
        with_it = [path for path in texts() if call in path.read_text(encoding="utf-8")]
        assert with_it
        for path in with_it:
            assert [each[:60] for each in told if each not in kept(path)] == []


# The kernel's own libraries warn about their internals.
@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", texts(), ids=lambda path: path.stem)
def test_notebook_runs(path: Path):
    cells = [cell for cell in executed(path).cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells)
    shown = {kind for cell in cells for output in cell.outputs for kind in output.get("data", {})}
    assert "image/png" in shown


def test_springs_from_a_counted_swing_are_those_of_a_held_arm() -> None:
    """By eigenvalues of the base's mass and stiffness with the joints fixed, as who counts a swing holds them."""
    told = {}
    for cell in jupytext.read(FOLDER / "your_own_machine.py").cells:
        if cell.cell_type == "code":
            exec(cell.source.replace("%matplotlib inline", ""), told)
        if "held" in told:
            break
    machine, held = told["machine"], told["held"]
    plant, p = flexopt.build_plant(machine), flexopt.build_plant(machine).parameter_values
    m, base = plant.n_passive, [0.0]
    mass = plant.mass(plant.rest(base, held, p), base, p).full()[:m, :m]
    (value,) = eigvalsh(plant.stiffness(p).full()[:m, :m], mass)
    assert np.sqrt(value) / (2 * np.pi) == pytest.approx(1.4, rel=1e-9)
    damping = plant.damping(p).full()[0, 0] / (2 * mass[0, 0] * np.sqrt(value))
    assert np.exp(-2 * np.pi * damping * 4) == pytest.approx(0.5, rel=1e-9)
