"""What the checks share: the bundle, a scratch folder, the samples, and how to compile.

In: a bundle's folder and how many inputs to compare. Out: a `Bench`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from flexopt.export.operations import Samples
from flexopt.export.sources import Library
from flexopt.export.verify.tools import run
from flexopt.foundation.arrays import Document

SAMPLE_SEED = 20


@dataclass(frozen=True)
class Bench:
    """One bundle under examination.

    Attributes:
        folder: of the bundle.
        scratch: for everything that is built.
        manifest: of the bundle.
        library: built again in Python from the manifest.
        inputs: random inputs for each function.
    """

    folder: Path
    scratch: Path
    manifest: Document
    library: Library
    inputs: int

    @property
    def single(self) -> bool:
        """Whether the bundle computes in single precision."""
        return self.library.real == "float"

    @property
    def tolerance(self) -> float:
        """Largest error allowed, as a share of each output's scale."""
        return float(self.manifest["tolerance"])

    @property
    def sources(self) -> list[Path]:
        """The library's C files."""
        names = [f"{self.library.prefix}_common.c"]
        names += [f"{self.library.prefix}_{part}.c" for part in self.library.parts]
        return [self.folder / "src" / name for name in names]

    @cached_property
    def samples(self) -> dict[str, Samples]:
        """Random inputs of each function that its guards accept, and Python's outputs."""
        parameters = self.library.context.parameters
        return {o.name: o.draw(parameters, self.inputs, SAMPLE_SEED) for o in self.library.all_operations}

    def includes(self) -> list[str]:
        """Folders of headers."""
        return [f"-I{self.folder / name}" for name in ("include", "src", "test")]

    def program(self, name: str, compiler: str, sources: Sequence[Path], flags: Sequence[str]) -> Path:
        """Compile and link."""
        target = self.scratch / name
        run([compiler, *flags, *self.includes(), *sources, "-o", target, "-lm"], folder=self.scratch)
        return target

    def objects(self, label: str, compiler: str, flags: Sequence[str]) -> dict[str, Path]:
        """Object file of each of the library's sources, by the name of its part (`"common"` for the rest).

        What was built under the same label is used again.
        """
        folder = self.scratch / label
        found = self._paths(folder)
        if found and all(path.exists() for path in found.values()):
            return found
        folder.mkdir(exist_ok=True)
        for source, target in zip(self.sources, found.values(), strict=True):
            run([compiler, *flags, *self.includes(), "-c", source, "-o", target], folder=folder)
        return found

    def _paths(self, folder: Path) -> dict[str, Path]:
        names = [source.stem for source in self.sources]
        return {name.removeprefix(f"{self.library.prefix}_"): folder / f"{name}.o" for name in names}
