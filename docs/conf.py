"""Sphinx: pages are Markdown (MyST); reference, file keys and errors are written from the code before each build."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from docs.docstrings import restructured, signature_of
from docs.gallery import write_pictures
from docs.generated import write_pages
from flexopt.foundation.documents import package_version

project = "flexopt"
copyright = "The flexopt developers"  # noqa: A001 - Sphinx's name
release = package_version("flexopt")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "docs.mathml"]
html_math_renderer = "mathml"
exclude_patterns = ["_build"]

myst_enable_extensions = ["dollarmath", "deflist", "fieldlist"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # tests/notebooks runs them; the site shows the outputs that are kept
suppress_warnings: list[str] = []

# References to flexopt's own names are checked; types of other packages have no inventory without the network.
nitpicky = True
nitpick_ignore_regex = [(kind, r"(?!flexopt\.\w+$).*") for kind in ("py:class", "py:exc", "py:data")]
default_role = "code"
autodoc_typehints = "none"  # those of calls are written by `signature_of`
python_maximum_signature_line_length = 100
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = "flexopt"
html_static_path = ["_static"]
html_css_files = ["flexopt.css"]
smartquotes = False  # which would make other words of `--option` and "text"
html_copy_source = False
html_show_sphinx = False


def setup(app: Any) -> None:
    """Pages are written, docstrings become reStructuredText."""
    app.connect("config-inited", lambda app, _: write_pages(Path(app.srcdir) / "generated"))
    app.connect("config-inited", lambda app, _: write_pictures(Path(app.srcdir) / "generated"))
    app.connect("autodoc-process-docstring", lambda *given: restructured(given[-1]), priority=400)
    app.connect("autodoc-process-signature", signature_of)
