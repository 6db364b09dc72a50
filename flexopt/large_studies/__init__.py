"""Studies that outgrow one process and one machine: very many points, in chunks that lie in files.

In: a `Study`, a folder, and whoever computes: processes, any `concurrent.futures.Executor`, a Dask cluster. Out: the
folder, whose files are the same whoever computed them, and what it holds as a `StudyResult`.
"""

from typing import TYPE_CHECKING

from flexopt.foundation.later import later

if TYPE_CHECKING:
    from flexopt.large_studies.result import StudyResult as StudyResult
    from flexopt.large_studies.result import open_study as open_study
    from flexopt.large_studies.running import run_study as run_study

__getattr__ = later(
    __name__,
    result="StudyResult open_study",
    running="run_study",
)
