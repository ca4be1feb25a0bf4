"""Count the tuned constants of registration, estimators and controller.

    python benchmarks/count_constants.py [SOURCE]

A tuned constant is a number that somebody chose: a module-level name in capitals that is bound to a number (or to
several: a tuple counts once), and a field of a dataclass with a number for a default. Zero, one, infinity, and names
that are only computed from other names do not count; nor does a constant whose comment or docstring states "not tuned"
or "by definition": limits of the user, sizes of tables, the paper's own parameters. ``SOURCE``: the package's folder,
this checkout's by default.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("registration", "estimators", "controller")
NEUTRAL = {0, 1}


def numbers(node: ast.expr) -> list[float]:
    """The numbers in an expression, without neutral ones and indices."""
    indices = {inner for child in ast.walk(node) if isinstance(child, ast.Subscript) for inner in ast.walk(child.slice)}
    return [
        child.value
        for child in ast.walk(node)
        if isinstance(child, ast.Constant)
        and child not in indices
        and isinstance(child.value, int | float)
        and not isinstance(child.value, bool)
        and child.value not in NEUTRAL
    ]


def is_dataclass(node: ast.ClassDef) -> bool:
    """Whether a class is decorated as a dataclass."""
    return any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)


def excused(node: ast.stmt, following: ast.stmt | None, lines: list[str]) -> bool:
    """Whether the comment on the line, or the docstring after it, states that the constant was not tuned."""
    text = " ".join(lines[node.lineno - 1 : node.end_lineno])
    if isinstance(following, ast.Expr):
        text += ast.unparse(following)
    return any(words in " ".join(text.lower().split()) for words in ("not tuned", "by definition"))


def constants(source: str) -> Iterator[tuple[int, str, str]]:
    """Line, name and value of each tuned constant of a module."""
    lines, body = source.splitlines(), ast.parse(source).body
    for node, following in zip(body, [*body[1:], None], strict=True):
        if excused(node, following, lines) and not isinstance(node, ast.ClassDef):
            continue
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and numbers(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                    if isinstance(name, ast.Name) and name.id.lstrip("_").isupper():
                        yield node.lineno, name.id, ast.unparse(node.value)
        if isinstance(node, ast.ClassDef) and is_dataclass(node):
            for field, after in zip(node.body, [*node.body[1:], None], strict=True):
                if not isinstance(field, ast.AnnAssign) or excused(field, after, lines):
                    continue
                if field.value is not None and numbers(field.value):
                    yield field.lineno, f"{node.name}.{ast.unparse(field.target)}", ast.unparse(field.value)


def main(source: Path) -> None:
    """Print every constant and their number."""
    total = 0
    for package in PACKAGES:
        for path in sorted((source / package).rglob("*.py")):
            found = list(constants(path.read_text()))
            total += len(found)
            for line, name, value in found:
                print(f"{package}/{path.name}:{line}: {name} = {value[:80]}")
    print(f"{total} tuned constants in {', '.join(PACKAGES)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "src" / "reorient")
