"""Names of CasADi Functions that `compiled` does by kernels of its own where they are made ready for many points.

Two rooms that do not know each other agree by them: `algebra`, which builds such Functions, and `compiled`. To whoever
does not look at the name, the graph says the same.
"""

from __future__ import annotations

# Of two dense matrices: A B, and the symmetric part of the square A + B. Nobody else's Function has such a name.
DENSE_PRODUCT, SYMMETRIC_SUM = "flexopt_dense_product", "flexopt_symmetric_sum"
