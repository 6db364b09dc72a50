"""Every case against its kept numbers; every public function has a case."""

from __future__ import annotations

import inspect

import pytest

import flexopt
from tests.golden.calls import CASES, EXEMPT, computed
from tests.golden.keeping import differences, kept_cases
from tests.golden.tolerances import DEFAULT, TABLE


@pytest.mark.long(*(name for name, case in CASES.items() if case.long))
@pytest.mark.parametrize("name", CASES)
def test_numbers_are_those_kept(name: str) -> None:
    found = differences(name, computed(name))
    assert not found, "\n".join(map(str, found[:20]))


def test_every_public_function_has_a_case() -> None:
    functions = {name for name in flexopt.__all__ if inspect.isfunction(getattr(flexopt, name))}
    covered = {name for case in CASES.values() for name in case.covers}
    assert covered | EXEMPT.keys() == functions
    assert not covered & EXEMPT.keys()
    assert all(EXEMPT.values()), "an exemption has a reason"


def test_nothing_is_kept_that_no_call_makes() -> None:
    assert kept_cases() == set(CASES)


def test_every_loose_tolerance_has_a_reason() -> None:
    bare = [pattern for pattern, row in TABLE if row.relative > DEFAULT.relative and not row.reason]
    assert not bare
