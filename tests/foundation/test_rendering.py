"""Texts come from templates alone: one dialect, every value given, names escaped, nothing loaded before it is needed."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from jinja2 import UndefinedError

import flexopt
from flexopt.foundation.rendering import render

ROOT = Path(flexopt.__file__).parent
EVIL = '<script>alert("x")</script> & \N{RIGHT-TO-LEFT OVERRIDE}\n*/ "'


def test_a_value_that_is_missing_is_an_error():
    with pytest.raises(UndefinedError, match="title"):
        render("foundation/templates/page.html", provenance={})


def test_names_in_html_are_text_wherever_they_stand():
    page = render("foundation/templates/page.html", title=EVIL, provenance={"name": EVIL})
    assert "<script" not in page
    assert "\N{RIGHT-TO-LEFT OVERRIDE}" not in page
    assert page.count("&lt;script&gt;") == 2  # the title and the heading; the document's quotes are JSON's


@pytest.mark.long
def test_no_module_writes_with_another_dialect():
    """`string.Template`, own marks for places and documents in strings are what templates replaced."""
    faults, words = [], ("<td", "<html", "#include <", "typedef ")
    # What is compiled at once and read by nobody is no document.
    for path in set(ROOT.rglob("*.py")) - set((ROOT / "compiled").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == "string":
                faults.append(f"{path.name}: from string import …")
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                faults += [f"{path.name}: {word}" for word in words if word in node.value]
    assert not faults


def test_templates_are_loaded_by_what_writes_alone():
    code = (
        "import sys, flexopt; flexopt.evaluate(flexopt.load('excavator'), [0.9, -2.6]); print('jinja2' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
