"""What each colour means, in pictures and on pages: one table, on a light and on a dark ground.

In: a theme. Out: colours by what they stand for. Told apart with colour-blind eyes, too, which a test simulates.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal, NamedTuple

Theme = Literal["light", "dark"]
THEMES: tuple[Theme, ...] = ("light", "dark")


class Palette(NamedTuple):
    """Colours by what they stand for, `#rrggbb`.

    Attributes:
        page, panel: grounds; halo: behind text and handles that lie on something.
        text, muted: letters; line: frames; grid: lines of a grid; focus: what the keyboard is on.
        present: where the machine stands now; chosen: what is proposed.
        other: what could be chosen as well; grows, settles, undecided: an oscillation, a verdict.
        base, undercarriage, edge: what stays the same of a machine; ground, ground_line: what it stands on.
        target: where the end-point shall be; obstacle: what must not be touched.
        allowed, forbidden: where the machine may stand, and where not.
        in_phase, out_of_phase: regions of a map.
        mark: points on coloured fields; emphasis: points where two measures are 0.
        measured, fitted: a log and what explains it.
        series: quantities side by side that mean nothing of all this, modes, joints, axes, runs.
    """

    page: str
    panel: str
    halo: str
    text: str
    muted: str
    line: str
    grid: str
    focus: str
    present: str
    chosen: str
    other: str
    grows: str
    settles: str
    undecided: str
    base: str
    undercarriage: str
    edge: str
    ground: str
    ground_line: str
    target: str
    obstacle: str
    allowed: str
    forbidden: str
    in_phase: str
    out_of_phase: str
    mark: str
    emphasis: str
    measured: str
    fitted: str
    series: tuple[str, ...]

    def css(self) -> dict[str, str]:
        """As CSS names them: `ground-line` for `ground_line`, `series-1` for the first of the series."""
        series = {f"series-{k + 1}": color for k, color in enumerate(self.series)}
        return {name.replace("_", "-"): value for name, value in self.named().items()} | series

    def named(self) -> dict[str, str]:
        """The single colours by name, all but the series."""
        return {name: value for name, value in self._asdict().items() if name != "series"}


LIGHT = Palette(
    page="#ffffff", panel="#f6f7f9", halo="#ffffff", text="#1c2530", muted="#566270", line="#c9d0d8", grid="#e3e6ea",
    focus="#0050b3", present="#3b6ea5", chosen="#d95f02", other="#8a8f94", grows="#a82505", settles="#0b6b5d",
    undecided="#8b7ca6", base="#777777", undercarriage="#444444", edge="#111111", ground="#efe9df",
    ground_line="#8a7a5c", target="#111111", obstacle="#8c564b", allowed="#1c8a5a", forbidden="#8e1b6b",
    in_phase="#f5d327", out_of_phase="#27509b", mark="#d81b1b", emphasis="#f0e442", measured="#9aa0a6",
    fitted="#2d155b", series=("#2d155b", "#aa4164", "#899d25", "#6a98af", "#5d45d3", "#5b2d15"),
)  # fmt: skip
DARK = Palette(
    page="#12161b", panel="#1c2229", halo="#12161b", text="#e6eaef", muted="#a5b0bc", line="#3b4551", grid="#2b333c",
    focus="#8fc1ff", present="#6fa3dc", chosen="#f0893a", other="#8f979f", grows="#e03e64", settles="#4fc9b4",
    undecided="#a894d6", base="#9aa0a6", undercarriage="#b4bac1", edge="#05070a", ground="#2a2620",
    ground_line="#a08f6c", target="#f5f7fa", obstacle="#b98376", allowed="#4cc38a", forbidden="#d96bd0",
    in_phase="#f5d327", out_of_phase="#27509b", mark="#ff5a52", emphasis="#f0e442", measured="#7d868f",
    fitted="#b9d4ef", series=("#b9d4ef", "#b87a85", "#d8c35a", "#5a5ad8", "#ac8fe5", "#b9efcb"),
)  # fmt: skip
PALETTES: dict[Theme, Palette] = {"light": LIGHT, "dark": DARK}
_USED = ContextVar[Palette]("_USED", default=LIGHT)


def colors() -> Palette:
    """Those of the picture that is being drawn."""
    return _USED.get()


@contextmanager
def painted_in(theme: Theme) -> Generator[Palette]:
    """Within it `colors()` are those of a theme."""
    before = _USED.set(PALETTES[theme])
    try:
        yield PALETTES[theme]
    finally:
        _USED.reset(before)
