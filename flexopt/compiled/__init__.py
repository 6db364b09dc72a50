"""Function in, faster Function out: compile, cache, load. Knows nothing of machines.

In: CasADi Functions. Out: their compiled twins (`accelerate`), with derivatives, for solvers and single calls; calls
with arrays (`ArrayCall`); their evaluation at many points (`batch`; `Economical`: compiled once that pays) or over many
steps (`recurrence`) in one call. Without a compiler all give the same results, more slowly, and one `CompilerNotFound`
warning for each process. Libraries are kept in `cache_folder()`, shared by processes, and may be deleted at any time.

Each name is imported when it is first asked for: what compiles nothing does not load what compiles.
"""

from typing import TYPE_CHECKING

from flexopt.foundation.later import later

if TYPE_CHECKING:
    from flexopt.compiled.accelerated import accelerate as accelerate
    from flexopt.compiled.batched import Batch as Batch
    from flexopt.compiled.batched import batch as batch
    from flexopt.compiled.calls import ArrayCall as ArrayCall
    from flexopt.compiled.compilers import Compiler as Compiler
    from flexopt.compiled.compilers import find_compiler as find_compiler
    from flexopt.compiled.economical import Economical as Economical
    from flexopt.compiled.recurrences import Records as Records
    from flexopt.compiled.recurrences import Recurrence as Recurrence
    from flexopt.compiled.recurrences import is_brief as is_brief
    from flexopt.compiled.recurrences import recurrence as recurrence
    from flexopt.compiled.storage import cache_folder as cache_folder

__getattr__ = later(
    __name__,
    accelerated="accelerate",
    batched="Batch batch",
    calls="ArrayCall",
    compilers="Compiler find_compiler",
    economical="Economical",
    recurrences="Records Recurrence is_brief recurrence",
    storage="cache_folder",
)
