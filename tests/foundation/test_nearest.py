"""A word is suggested only where it was probably meant."""

import pytest

from flexopt.foundation.nearest import hint, hint_or_list


@pytest.mark.parametrize(
    ("word", "known", "meant"),
    [
        ("lover", ("lower", "upper"), "lower"),
        ("mas", ("mass", "inertia"), "mass"),
        ("stifness", ("stiffness",), "stiffness"),
    ],
)
def test_slip_of_the_pen(word, known, meant):
    assert hint(word, known) == f"; did you mean {meant!r}?"


def test_another_word_is_no_slip():
    # A spring is the other one of the two; its letters are some of those of damping.
    told = hint_or_list("spring", ("stiffness", "damping"))
    assert told == "; valid here: stiffness, damping"


def test_parts_of_a_dotted_name_may_stand_in_another_order() -> None:
    known = ["base.z.stiffness", "base.pitch.stiffness", "base.pitch.damping"]
    assert hint("base.stiffness.pitch", known) == "; did you mean 'base.pitch.stiffness'?"
