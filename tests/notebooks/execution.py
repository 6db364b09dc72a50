"""A notebook from its text, executed: what the tests run, and `python -m tests.notebooks.execution NAME …` writes.

The texts are notebooks/*.py, one cell after each `# %%`; the .ipynb beside them are the same with their outputs.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
# Every notebook takes less than two minutes; this is for slow machines.
LIMIT_S = 300
METADATA = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"}}  # fmt: skip


def texts() -> list[Path]:
    """The texts of all notebooks."""
    return sorted(FOLDER.glob("*.py"))


def executed(text: Path) -> Any:
    """The notebook of a text, with its outputs."""
    notebook = jupytext.read(text)
    client = NotebookClient(notebook, timeout=LIMIT_S, kernel_name="python3", resources={"metadata": {"path": FOLDER}})
    client.execute()
    return notebook


def write(text: Path) -> None:
    """Execute it and write the .ipynb; what says nothing of the work itself is left out, so that changes are few."""
    notebook = executed(text)
    notebook.metadata = METADATA
    for number, cell in enumerate(notebook.cells):
        cell["id"], cell["metadata"] = f"cell-{number}", {}
    nbformat.write(notebook, text.with_suffix(".ipynb"))


if __name__ == "__main__":
    for path in [FOLDER / f"{name}.py" for name in sys.argv[1:]] or texts():
        write(path)
        print(path.stem)
