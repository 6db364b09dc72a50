"""What numbers of another unit are asked."""

from __future__ import annotations

import pytest

import flexopt


@pytest.mark.parametrize("dead_time", [15.0, 1e4])
def test_dead_times_beyond_any_loop_ask_for_milliseconds(dead_time: float) -> None:
    with pytest.raises(flexopt.InputError, match=r"between 0 and 10 s; is it in ms\?"):
        flexopt.Loop(kp=1e4, kv=1e3, dead_time=dead_time)


@pytest.mark.parametrize("dead_time", [1.1e4, -1.0])
def test_what_is_no_dead_time_in_milliseconds_either_is_not_asked(dead_time: float) -> None:
    with pytest.raises(flexopt.InputError, match=r"between 0 and 10 s$"):
        flexopt.Loop(kp=1e4, kv=1e3, dead_time=dead_time)


def test_durations_are_not_asked_for_milliseconds() -> None:
    with pytest.raises(flexopt.InputError, match=r"at most 1e\+06 s$"):
        flexopt.simulate(flexopt.load("excavator"), (0.99, -2.6), control="inverse", kp=1e4, kv=1e3, duration=2e6)
