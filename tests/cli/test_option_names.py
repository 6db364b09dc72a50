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
        (
            ["region", "excavator", "--posture", "0.04,-2.05", *LOOP, "--ranges", "base.stiffness.*=x2,x0.5"],
            "--ranges[0].factor = [2.0, 0.5]",
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


def test_ends_after_an_x_are_one_factor_of_all_that_is_meant(command: Command) -> None:
    words = ["region", "excavator", "--posture", "0.04,-2.05", *LOOP, "--boxes", "0", "--points", "4", "--json"]
    asked = [["stiffness=0.5,2"], ["base.stiffness.*=x0.5,x2"], ["base.stiffness.*=x0.5,x2", "payload.mass=0,100"]]
    regions = [command(*words, *(word for each in some for word in ("--ranges", each))).document for some in asked]
    assert regions[1]["critical"] == {"base.stiffness.*": 0.5}
    assert regions[1]["decay"] == pytest.approx(regions[0]["decay"], rel=1e-9)
    assert set(regions[2]["critical"]) == {"base.stiffness.*", "payload.mass"}
