"""What each command prints, against its snapshot: sentences alone, every number masked."""

from __future__ import annotations

import pytest

from flexopt.cli.commands import COMMANDS
from tests.wording.commands import FOLDER, LINES, masked, printed

# It computes the whole article; its page has tests of its own.
WITHOUT_SNAPSHOT = {"reproduce"}


@pytest.mark.parametrize("snapshot", LINES)
def test_a_command_prints_what_its_snapshot_says(snapshot: str) -> None:
    assert printed(snapshot) == (FOLDER / f"{snapshot}.txt").read_text(encoding="utf-8")


def test_every_command_has_a_snapshot() -> None:
    assert set(LINES) == set(COMMANDS) - WITHOUT_SNAPSHOT | {"help"}
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(LINES)


def test_no_number_is_left_in_a_snapshot() -> None:
    assert masked("w1 = -1.5e-08 1/(kg m2), 2 of  3 starts; −4, 1e+05\n") == "w1 = # #/(kg m2), # of # starts; #, #\n"
