"""Files of others: read whole, up to a limit. Pipes and devices are refused, as they may have no end."""

from __future__ import annotations

import errno
from pathlib import Path


def read_bounded(path: Path, most: int) -> bytes:
    """Return what a file holds.

    Raises:
        OSError: it cannot be read, is no regular file, or has more than `most` bytes; `strerror` says which.
    """
    try:
        if path.exists() and not path.is_file():
            raise OSError(errno.EINVAL, "it is a folder" if path.is_dir() else "it is no file")
        with path.open("rb") as stream:
            content = stream.read(most + 1)
    except ValueError:  # a name that no system takes
        raise OSError(errno.EINVAL, "its name is unusable") from None
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most // 1000} kB")
    return content
