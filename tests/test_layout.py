"""The layout: modules import in one order, one machine from any file, a name for a class, and a map that is true."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import grimp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import flexopt
from flexopt.model import Machine, Tree

PACKAGE = Path(flexopt.__file__).parent
# What the two kinds of machine file are made of; below `model/` a machine is what these have in common.
KINDS = {"planar", "planar_faults", "tree", "tree_faults"}
MAP = (PACKAGE / "README.md").read_text(encoding="utf-8").splitlines()


def modules() -> Iterator[tuple[str, ast.Module]]:
    """Every module by its path in the package."""
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


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


def test_no_import_is_left_out_of_the_order() -> None:
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    (layers,) = project["tool"]["importlinter"]["contracts"]
    assert set(layers) == {"name", "type", "layers"}
    rooms = {name.strip() for layer in layers["layers"] for name in layer.split("|")}
    there = {f"flexopt.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py")} | {"flexopt.errors"}
    assert rooms == there - {"flexopt.models", "flexopt.problems"}


def of_one_file_format(tree: ast.Module) -> list[str]:
    """Where a module names what one kind of machine file alone has."""
    found: list[str] = []
    own = {kind: {*dir(kind), *kind.model_fields} for kind in (Machine, Tree)}
    alone = {name for name in own[Machine] ^ own[Tree] if not name.startswith("_")}
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) if name in {"Machine", "Tree"}:
                found.append(f"{node.lineno}: {name}")
            case ast.Attribute(attr=name, value=ast.Name(id=owner) | ast.Attribute(attr=owner)) if name in alone:
                found += [f"{node.lineno}: {owner}.{name}"] if owner == "machine" else []
            case ast.Call(func=ast.Name(id="getattr" | "hasattr"), args=[ast.Name(id="machine"), *_]):
                found.append(f"{node.lineno}: getattr(machine, …)")
            case ast.ImportFrom(module=str(module), names=names):
                parts = [*module.split("."), *(each.name for each in names)]
                if parts[:2] == ["flexopt", "model"] and KINDS & set(parts[2:3]):
                    found.append(f"{node.lineno}: {module}")
            case _:
                pass
    return found


def test_nothing_below_the_model_asks_from_which_file_a_machine_came() -> None:
    """It names neither class, none of a class's own members, none of its module's functions."""
    # The checker of certificates has a machine of its own, read from a log.
    others = [(path, tree) for path, tree in modules() if path != "selection/certificate/check.py"]
    branches = {path: of_one_file_format(tree) for path, tree in others if not path.startswith("model/")}
    assert {path: found for path, found in branches.items() if found} == {}
    seen = "from flexopt.model.tree import x\nif isinstance(machine, flexopt.Machine): machine.links\nTree"
    assert len(of_one_file_format(ast.parse(seen))) == 4


def test_a_class_name_means_one_thing() -> None:
    places = defaultdict[str, list[str]](list)
    for path, tree in modules():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path}:{node.lineno}")
        for node in tree.body:
            # Names of types alone: T and P are parameters of what stands below them.
            match node:
                case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                    if re.fullmatch(r"[A-Z][a-z]\w*", name):
                        places[name].append(f"{path}:{node.lineno}")
                case _:
                    pass
    assert len(places) > 500
    assert "Vector" in places
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def named(line: str) -> tuple[set[Path], list[str]]:
    """Files and folders that a line of the map names, and names of none: a folder is said before what lies in it."""
    folders, found, wrong = [PACKAGE], set[Path](), list[str]()
    for name in re.findall(r"`([\w./*]+(?:/|\.(?:py|h|c)))`", line):
        hits = [path for folder in folders for path in folder.glob(name.rstrip("/"))]
        if not hits or (name.endswith("/") and not all(path.is_dir() for path in hits)):
            wrong.append(name)
        found.update(hits)
        for path in hits:
            above = [each for each in (path, *path.parents) if each.is_dir() and each.is_relative_to(PACKAGE)]
            folders += [each for each in above if each not in folders]
    return found, wrong


def test_the_map_names_what_is_there() -> None:
    assert {line: wrong for line in MAP if (wrong := named(line)[1])} == {}
    assert named("`selection/nothing.py`")[1] == ["selection/nothing.py"]


def test_the_map_names_every_room_and_its_rooms() -> None:
    paths = set[Path]().union(*(named(line)[0] for line in MAP))
    found = {room for path in paths for room in (path, path.parent)}
    rooms = {path.parent for path in PACKAGE.rglob("__init__.py")} - {PACKAGE}
    assert rooms - found == set()


def test_the_map_answers_where_to_add_what() -> None:
    """Each question by a path."""
    start = MAP.index("| to add | go to |") + 2
    answers = {line.split("|")[1].strip(): named(line.split("|")[2])[0] for line in MAP[start : MAP.index("", start)]}
    questions = (
        "constraint", "objective", "measure", "joint type", "file format", "controller law", "actuator", "integrator",
        "exported function", "picture", "command",
    )  # fmt: skip
    assert [each for each in questions if not any(each in question for question in answers)] == []
    assert [question for question, paths in answers.items() if not paths] == []


def third_party(tree: ast.AST) -> set[str]:
    """Packages of others that a module imports, by name or by `import_module`."""
    found = set[str]()
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names):
                found |= {each.name for each in names}
            case ast.ImportFrom(module=str(module), level=0):
                found.add(module)
            case ast.Call(func=ast.Name(id="import_module"), args=[ast.Constant(value=str(module))]):
                found.add(module)
            case _:
                pass
    return {module.partition(".")[0] for module in found} - sys.stdlib_module_names - {"flexopt"}


def undeclared(imported: Iterable[str], requirements: Iterable[str]) -> list[str]:
    """Imported packages that none of the requirements installs by name."""
    declared = {_normal(re.split(r"[\s\[<>=;]", requirement)[0]) for requirement in requirements}
    distributions = packages_distributions()
    return sorted(name for name in imported if not {_normal(each) for each in distributions.get(name, ())} & declared)


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_what_is_imported_is_declared() -> None:
    """Import statements name packages of `dependencies`; `import_module` may name one of an extra, too."""
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    always, later = set[str](), set[str]()
    for _, tree in modules():
        always |= {
            name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in third_party(node)
        }
        later |= third_party(tree)
    extras = project["optional-dependencies"]
    optional = [each for name in ("meshes", "certificates", "cluster", "compiler") for each in extras[name]]
    # Whoever passes a system of python-control has it.
    later -= {"control"}
    assert {"casadi", "pandas", "PIL", "markupsafe", "trimesh"} <= later
    assert undeclared(always - {"flint"}, project["dependencies"]) == []
    assert undeclared(later, [*project["dependencies"], *optional]) == []
    assert undeclared({"PIL", "flint"}, ["pillow>=10", "numpy"]) == ["flint"]
