"""Faults of a call name the options by which a command was asked."""

from __future__ import annotations

import pytest

from tests.cli.command import Command

LOOP = ["--loop", "kp=1e4", "--loop", "kv=1e3"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["verdict", "excavator", "--end-point", "0,1.6", *LOOP], "--base: is needed"),
        (
            ["region", "excavator", "--posture", "0.04,-2.05", *LOOP, "--ranges", "stifness=0.5,2"],
            "--ranges[0].of = stifness",
        ),
        (
            ["region", "excavator", "--posture", "0.04,-2.05", *LOOP, "--ranges", "stiffness=2,0.5"],
            "--ranges['stiffness']",
        ),
        (["evaluate", "excavator", "--posture", "0.04,-2.05", "--loop", "kp=-1"], "--loop kp = -1"),
        (["select", "article", "--objective", "decay", *LOOP, "--ranges", "stiffness=3,2"], "--ranges['stiffness']"),
        (["evaluate", "excavator", "--posture", "0.04,-2.05", "--gain", "-1"], "--gain = -1"),
        *(
            (
                ["evaluate", "excavator", "--posture", "0.04,-2.05", "--loop", f"kp=1e4{between}kv=1e3"],
                "give each its own: --loop kp=1e4 --loop kv=1e3",
            )
            for between in (",", " ", ", ")
        ),
    ],
)
def test_the_option_is_named(arguments: list[str], said: str, command: Command) -> None:
    done = command(*arguments)
    assert done.code == 2
    assert said in done.stderr, done.stderr
