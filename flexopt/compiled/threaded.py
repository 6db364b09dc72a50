"""A Function at many points by CasADi's virtual machine, on several threads.

In: a dense Function; for each input an array with one column for each point. Out: for each output the like.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import casadi as ca
import numpy as np

from flexopt.compiled.interpreted import Interpreted
from flexopt.foundation.arrays import Array

# As many points as a call of the virtual machine takes at once keep a thread busy for longer than it takes to start.
POINTS_EACH = 16


class Interpreter:
    """Evaluates a Function at N points; called like a `Batch`, with the same results to rounding."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._workers: list[Interpreted] = []

    def __call__(self, *arrays: Array, threads: int = 1) -> list[Array]:
        """The outputs at N points, each (rows_out, N).

        Args:
            arrays: for each input (rows, N), or (rows,) for one value at all points.
            threads: among how many the points are divided; the results do not depend on it.
        """
        given = [np.asarray(array, dtype=np.float64) for array in arrays]
        inputs = [array.reshape(-1, 1) if array.ndim < 2 else array for array in given]
        lengths = {array.shape[1] for array in inputs} - {1}
        count = lengths.pop() if lengths else 1
        function = self.function
        outputs = [np.empty((function.numel_out(k), count)) for k in range(function.n_out())]
        # Starting a thread costs more than a few points.
        threads = max(1, min(threads, count // POINTS_EACH))
        edges = [count * k // threads for k in range(threads + 1)]
        parts = [(begin, end) for begin, end in pairwise(edges) if end > begin]
        while len(self._workers) < len(parts):
            self._workers.append(Interpreted(function))
        if len(parts) == 1:
            self._workers[0](inputs, outputs, *parts[0])
            return outputs
        with ThreadPoolExecutor(max(1, len(parts))) as pool:
            jobs = [
                pool.submit(worker, inputs, outputs, *part) for worker, part in zip(self._workers, parts, strict=False)
            ]
            for job in jobs:
                job.result()
        return outputs
