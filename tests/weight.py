"""Count code and hard sentences. `python -m tests.weight` prints the figures; `--lower` writes those that fell.

Figures are kept in `weight.toml` and only fall. Whoever must raise one does so by hand, with the reason beside it.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = Path(__file__).with_name("weight.toml")
LONG = 25  # words
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
NO_TEMPLATE = (".py", ".md", ".typed", ".toml", ".json", ".pyc")
HAS_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
POSTPONED = re.compile(
    r"(Of|What|That|Whether|Which|Where|Who|With what|By which|For which|Those|Such|None|Nor|The like|The same)\b(?!'s)"
)
NO_PROSE = re.compile(r"```.*?```|^\|.*?$|^\s*<!--.*?-->|!\[[^\]]*\]\([^)]*\)|\$\$.*?\$\$|^#.*?$", re.S | re.M)
MARKUP = re.compile(r"\[([^\]]*)\]\([^)]*\)|`([^`]*)`|\$([^$]*)\$|\*+")
BREAK = re.compile(r"\n\s*\n|\n\s*(?:[-*:]|\d+\.)\s+")
STOP = re.compile(r"(?<=[.!?])\s+(?=[A-Zαβκωτε(])|(?<=:)\s+(?=[A-Z])")
EXAMPLE = re.compile(r"(?ms)^\s*Example:.*")
LABEL = re.compile(
    r"(?m)^\s*(?:Args|Returns|Raises|Attributes|Yields|Note):\s*$|^\s*`?[\w*.]+`?(?:, `?[\w*.]+`?)*(?: \([^)]*\))?: "
)


def files(top: str, *suffixes: str) -> list[Path]:
    """Return the files under a folder of the project, build products left out."""
    found = (path for path in (ROOT / top).rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sorted(path for path in found if not suffixes or path.suffix in suffixes)


def docstrings(tree: ast.Module) -> Iterator[ast.Constant]:
    """Yield the docstrings of a module."""
    for node in ast.walk(tree):
        first = node.body[0] if isinstance(node, HAS_DOCSTRING) and node.body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
            yield first.value


def code_of(text: str) -> Counter[str]:
    """Count a module: code lines without docstrings and comments, constants, functions that return text."""
    tree = ast.parse(text)
    lines = set[int]()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for doc in docstrings(tree):
        lines.difference_update(range(doc.lineno, (doc.end_lineno or 0) + 1))
    returned = [ast.unparse(f.returns) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) and f.returns]
    texts = [r for r in returned if re.search(r"\bstr\b", re.sub(r"\b(dict|Mapping|Counter)\[str\b", "[", r))]
    targets = [t for n in tree.body if isinstance(n, ast.Assign) for t in n.targets]
    targets += [n.target for n in tree.body if isinstance(n, ast.AnnAssign)]
    names = [t.elts if isinstance(t, ast.Tuple) else [t] for t in targets]
    constants = sum(len(each) for each in names if all(isinstance(e, ast.Name) and e.id.isupper() for e in each))
    return Counter(code_lines=len(lines), modules=1, constants=constants, functions_that_return_text=len(texts))


def sentences(text: str) -> list[str]:
    """Split prose into sentences of more than three words; code and formulas count as one word."""
    text = MARKUP.sub(lambda m: m[1] or ("code" if m[2] or m[3] else ""), text)
    flat = (re.sub(r"\s+", " ", paragraph).strip() for paragraph in BREAK.split(text))
    return [s for paragraph in flat for s in STOP.split(paragraph) if len(s.split()) > 3]


def hard(name: str, found: list[str]) -> Counter[str]:
    """Count sentences that are too long, and those that postpone their subject."""
    inverted = [s for s in found if POSTPONED.match(s) and not s.endswith("?")]
    long = [s for s in found if len(s.split()) > LONG]
    return Counter({f"long_sentences_of_{name}": len(long), f"inverted_sentences_of_{name}": len(inverted)})


def figures() -> dict[str, int]:
    """Return the figures of the project as it is."""
    total = Counter[str]()
    for path in files("flexopt", ".py"):
        text = path.read_text(encoding="utf-8")
        total += code_of(text)
        prose = (LABEL.sub("\n\n", EXAMPLE.sub("", str(doc.value))) for doc in docstrings(ast.parse(text)))
        total += hard("docstrings", [s for each in prose for s in sentences(each)])
    templates = [path for path in files("flexopt") if path.suffix not in NO_TEMPLATE]
    total["lines_of_c_and_templates"] = sum(path.read_bytes().count(b"\n") for path in templates)
    pages = [*ROOT.glob("*.md"), *(p for top in ("docs", "flexopt", "models", "problems") for p in files(top, ".md"))]
    read = [p for p in pages if not {"_build", "generated", "templates"} & set(p.parts) and p.name != "CHANGELOG.md"]
    total += hard(
        "documents", [s for p in read for s in sentences(NO_PROSE.sub("\n\n", p.read_text(encoding="utf-8")))]
    )
    return dict(total)


def kept() -> dict[str, int]:
    """Return the figures that may not be exceeded."""
    return tomllib.loads(KEPT.read_text(encoding="utf-8"))


def lower() -> None:
    """Write the figures that fell; reasons beside the others stay."""
    now, text = figures(), KEPT.read_text(encoding="utf-8")
    for name, value in kept().items():
        if now[name] < value:
            text = re.sub(rf"(?m)^{name} = \d+.*$", f"{name} = {now[name]}", text)
    KEPT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] == ["--lower"]:
        lower()
    for name, value in figures().items():
        print(f"{name:36}{value:7}   kept {kept()[name]:7}")
