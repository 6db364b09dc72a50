"""Every text that flexopt writes from a template: C, HTML, Markdown, build files, in one dialect.

In: the path of a template inside this package, and its values. Out: the text. A template looks like what it makes; its
places are Jinja's. A value that a template asks for and does not get is an error. What goes into HTML is escaped unless
it is markup already; a user's name goes into C through the filter `c_text`.
"""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any, cast

from flexopt.foundation.escapes import c_text, markup

if TYPE_CHECKING:
    from jinja2 import Environment
    from jinja2.nodes import EvalContext


# As `--payload-mass`.
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


class OfNumbers(str):
    """Name of a column of a page's table that holds numbers: they stand right, and so do words in place of one."""

    __slots__ = ()


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
        finalize=pass_eval_context(_escaped),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    cast(dict[str, Any], environment.filters).update(c_text=c_text, with_options=_with_options)
    cast(dict[str, Any], environment.tests).update(of_numbers=_of_numbers)
    return environment


def _with_options(text: str) -> Any:
    """A sentence for HTML, in which no line ends within an option of the shell."""
    from markupsafe import Markup  # noqa: PLC0415

    return Markup(_OPTION.sub(r'<span class="option">\g<0></span>', markup(text)))


def _of_numbers(name: object) -> bool:
    return isinstance(name, OfNumbers)


def _escaped(context: EvalContext, value: object) -> object:
    """Text on its way into HTML, unless it is markup already."""
    from markupsafe import Markup  # noqa: PLC0415

    if not context.autoescape or not isinstance(value, str) or isinstance(value, Markup):
        return value
    return Markup(markup(value))
