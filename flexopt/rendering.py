"""Every text that flexopt writes from a template: C, HTML, Markdown, build files, in one dialect.

In: the path of a template inside this package, and its values. Out: the text. A template looks like what it makes; its
places are Jinja's. A value that a template asks for and does not get is an error. What goes into HTML is escaped and
put on one line unless it is markup already; a user's name goes into C through the filter `c_text`.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, cast

from flexopt.escapes import c_text, one_line

if TYPE_CHECKING:
    from jinja2 import Environment
    from jinja2.nodes import EvalContext


def render(path: str, /, **values: object) -> str:
    """The template at `path` (`"export/templates/header.h"`) with its places filled.

    Raises:
        jinja2.UndefinedError: a value is missing.
    """
    return _environment().get_template(path).render(values)


@cache
def _environment() -> Environment:
    # Only what writes such a text needs it.
    from jinja2 import Environment, PackageLoader, StrictUndefined, pass_eval_context  # noqa: PLC0415

    environment = Environment(
        loader=PackageLoader("flexopt", "."),
        undefined=StrictUndefined,
        autoescape=lambda name: name is not None and name.endswith(".html"),
        finalize=pass_eval_context(_plain),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    cast(dict[str, Any], environment.filters).update(c_text=c_text)
    return environment


def _plain(context: EvalContext, value: object) -> object:
    """Text on its way into HTML without control characters and marks that turn the direction of writing."""
    return one_line(value) if context.autoescape and type(value) is str else value
