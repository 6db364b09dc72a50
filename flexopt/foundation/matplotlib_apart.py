"""Matplotlib, imported without the file of settings that it would obey from the working directory.

Rooms that draw import this first. Nothing but drawing may import it: Matplotlib is slow to load.
"""

from contextlib import chdir, nullcontext
from pathlib import Path

with chdir(Path(__file__).parent) if Path("matplotlibrc").exists() else nullcontext():
    import matplotlib

__all__ = ["matplotlib"]
