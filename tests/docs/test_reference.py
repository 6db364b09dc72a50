"""Every public name stands on one page of the reference."""

from __future__ import annotations

import flexopt
from docs.public import TOPICS, names


def test_every_public_name_is_in_the_reference() -> None:
    listed = [name for topic in TOPICS for name in names(topic)]
    assert sorted(listed) == sorted(flexopt.__all__)
