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


def test_the_quantity_of_an_owner_that_both_names_have_is_to_be_alike() -> None:
    known = ["base.pitch.rest", "stiffness.base.roll.base.roll", "boom.mass"]
    assert "did you mean" not in hint_or_list("base.pitch.stiffness", known)
    assert hint("base.pitch.rast", known) == "; did you mean 'base.pitch.rest'?"
    assert hint("boom.mass.x", known) == "; did you mean 'boom.mass'?"


def test_a_name_with_all_parts_that_were_given_and_the_fewest_others_is_meant() -> None:
    known = ["base.pitch.rest", "damping.base.pitch.base.pitch", "stiffness.base.x.base.pitch"]
    known += ["stiffness.base.pitch.base.pitch", "stiffness.base.x.base.x"]
    assert hint("base.pitch.stiffness", known) == "; did you mean 'stiffness.base.pitch.base.pitch'?"
    assert hint("pitch.x.base.stiffness", known) == "; did you mean 'stiffness.base.x.base.pitch'?"


def test_a_long_list_hides_no_kind() -> None:
    known = [f"link{k}.{what}" for k in range(30) for what in ("mass", "com.x", "com.y", "inertia.xx")]
    known += [f"stiffness.{a}.{b}" for a in "uvw" for b in "uvw"] + [f"link{k}.length" for k in range(30)] + ["gravity"]
    told = hint_or_list("nothing", known, most=12)
    assert told.endswith(", …")
    shown = told.removeprefix("; valid here: ").removesuffix(", …").split(", ")
    assert len(shown) == 12
    assert shown == [each for each in known if each in shown]
    assert {"mass", "com", "x", "y", "inertia", "xx", "stiffness", "u", "v", "w", "length", "gravity"} <= {
        part for each in shown for part in each.split(".")
    }
