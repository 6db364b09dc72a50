"""Every notebook runs from top to bottom, and what is kept of it is what its text says."""

from pathlib import Path

import jupytext
import nbformat
import pytest

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


# The kernel's own libraries warn about their internals.
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", texts(), ids=lambda path: path.stem)
def test_notebook_runs(path: Path):
    cells = [cell for cell in executed(path).cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells)
    shown = {kind for cell in cells for output in cell.outputs for kind in output.get("data", {})}
    assert "image/png" in shown
