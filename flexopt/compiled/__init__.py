"""Function in, faster Function out: compile, cache, load. Knows nothing of machines.

In: CasADi Functions. Out: their compiled twins (`accelerate`), with derivatives, for solvers and single calls; and
their evaluation at many points at once (`batch`). Without a compiler both give the same results, more slowly, and one
`CompilerNotFound` warning for each process. Libraries are kept in `cache_folder()`, shared by processes, and may be
deleted at any time.
"""

from flexopt.compiled.accelerated import accelerate as accelerate
from flexopt.compiled.batched import Batch as Batch
from flexopt.compiled.batched import batch as batch
from flexopt.compiled.compilers import Compiler as Compiler
from flexopt.compiled.compilers import find_compiler as find_compiler
from flexopt.compiled.storage import cache_folder as cache_folder
