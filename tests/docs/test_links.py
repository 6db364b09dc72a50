"""Links of the Markdown files lead to files, headings and pages that are there; the network is not asked."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted({*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "howto").glob("*.md")})
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def anchors(text: str) -> set[str]:
    """Of headings, as MyST and code forges call them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken(path: Path, text: str) -> Iterator[str]:
    """Links of a page that lead nowhere; pages that the build writes are those of docs/generated.py."""
    written = (ROOT / "docs" / "generated.py").read_text(encoding="utf-8")
    for link in LINK.findall(CODE.sub("", text)):
        if re.match(r"\w+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        if target.parent.name == "generated":
            stem = target.stem.partition("-")[0]
            if f'"{stem}' not in written and f'f"{stem}-' not in written:
                yield link
            continue
        there = target.exists()
        if not there or (anchor and anchor not in anchors(target.read_text(encoding="utf-8") if name else text)):
            yield link


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_links_lead_somewhere(path: Path) -> None:
    assert list(broken(path, path.read_text(encoding="utf-8"))) == []


def test_a_broken_link_is_found() -> None:
    page = "[a](nowhere.md) [b](#no-heading) [c](generated/nothing.md) [d](https://example.org) `[e](code.md)`\n# Heading\n[f](#heading)"
    path = ROOT / "docs" / "index.md"
    assert list(broken(path, page)) == ["nowhere.md", "#no-heading", "generated/nothing.md"]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) < 200
