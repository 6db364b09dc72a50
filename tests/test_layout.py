"""The modules of the package stand in an order: none imports itself by way of others, not even inside a function."""

from __future__ import annotations

import grimp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components


def circles(graph: grimp.ImportGraph) -> list[list[str]]:
    """Modules that import each other, directly or by way of others: strongly connected components of two and more."""
    modules = sorted(graph.modules)
    at = {module: k for k, module in enumerate(modules)}
    arrows = [(at[m], at[n]) for m in modules for n in graph.find_modules_directly_imported_by(m)]
    importers, imported = np.array(arrows).T
    matrix = csr_array((np.ones(len(arrows)), (importers, imported)), shape=(len(modules), len(modules)))
    _, labels = connected_components(matrix, directed=True, connection="strong")
    groups = [[modules[k] for k in np.flatnonzero(labels == label)] for label in set(labels.tolist())]
    return sorted(group for group in groups if len(group) > 1)


def test_no_modules_import_each_other() -> None:
    graph = grimp.build_graph("flexopt", exclude_type_checking_imports=True, cache_dir=None)
    assert len(graph.modules) > 200
    assert circles(graph) == []
    # The same walk sees a circle where there is one, also where a function imports.
    graph.add_import(importer="flexopt.errors", imported="flexopt.model.machine")
    assert any({"flexopt.errors", "flexopt.model.machine"} <= set(group) for group in circles(graph))
