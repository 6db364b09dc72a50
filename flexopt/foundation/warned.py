"""Warnings at the user's line."""

from __future__ import annotations

import functools
import inspect
import warnings
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def warn_user(sentence: str, category: type[Warning]) -> None:
    """Warn where the user's program calls flexopt, however deep in it the sentence is said."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_back is not None and _within(frame.f_code.co_filename):
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence, category, stacklevel=level)


def _within(file: str) -> bool:
    """Whether flexopt's own, or between its calls: properties that are kept are read by way of functools."""
    return Path(file).is_relative_to(PACKAGE) or file == functools.__file__
