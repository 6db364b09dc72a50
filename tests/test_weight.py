"""The weight can only fall: figures of code and of hard sentences, as kept in `weight.toml`."""

from __future__ import annotations

from collections import Counter

from tests import weight


def test_figures_are_those_that_are_kept() -> None:
    now, kept = weight.figures(), weight.kept()
    heavier = {name: (value, kept[name]) for name, value in now.items() if value > kept[name]}
    assert not heavier, f"above tests/weight.toml: {heavier}; delete, or raise the figure there and say why"
    lighter = {name: (value, kept[name]) for name, value in now.items() if value < kept[name]}
    assert not lighter, f"below tests/weight.toml: {lighter}; run python -m tests.weight --lower"
    assert now.keys() == kept.keys()


def test_ten_lines_of_code_count_and_docstrings_and_comments_do_not() -> None:
    text = (
        '"""A module."""\n\nSIZE = 1\n\n\ndef name() -> str | None:\n    """Return."""\n    # Why.\n    return None\n'
    )
    more = text + "".join(f"LIMIT_{k} = {k}\n" for k in "ABCDEFGHIJ")
    assert weight.code_of(text) == {"code_lines": 3, "modules": 1, "constants": 1, "functions_that_return_text": 1}
    assert weight.code_of(more) - weight.code_of(text) == Counter(code_lines=10, constants=10)


def test_a_sentence_of_sixty_words_counts_and_one_that_postpones_its_subject() -> None:
    page = "The base gives way. A mode is damped by the feedback."
    assert weight.hard("documents", weight.sentences(page)).total() == 0
    long = weight.sentences(f"{page} It is {'very ' * 57}long.")
    inverted = weight.sentences(f"{page} What the base does is seen there. What does it do?")
    assert weight.hard("documents", long) == {"long_sentences_of_documents": 1, "inverted_sentences_of_documents": 0}
    assert weight.hard("documents", inverted) == {
        "long_sentences_of_documents": 0,
        "inverted_sentences_of_documents": 1,
    }
