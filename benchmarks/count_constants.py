"""Count the tuned constants of registration, estimators and controller.

    python benchmarks/count_constants.py [SOURCE]

A tuned constant is a number that somebody chose: a module-level name in capitals that is bound to a number (or to
several: a tuple counts once), and a field of a dataclass with a number for a default. Zero, one, infinity, and names
that are only computed from other names do not count. ``SOURCE``: the package's folder, this checkout's by default.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("registration", "estimators", "controller")
NEUTRAL = {0, 1}


def numbers(node: ast.expr) -> list[float]:
    """The numbers in an expression, without neutral ones and those that only convert units."""
    return [
        child.value
        for child in ast.walk(node)
        if isinstance(child, ast.Constant)
        and isinstance(child.value, int | float)
        and not isinstance(child.value, bool)
        and child.value not in NEUTRAL
    ]


def is_dataclass(node: ast.ClassDef) -> bool:
    """Whether a class is decorated as a dataclass."""
    return any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)


def constants(tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Line, name and value of each tuned constant of a module."""
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and numbers(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                    if isinstance(name, ast.Name) and name.id.lstrip("_").isupper():
                        yield node.lineno, name.id, ast.unparse(node.value)
        if isinstance(node, ast.ClassDef) and is_dataclass(node):
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and field.value is not None and numbers(field.value):
                    yield field.lineno, f"{node.name}.{ast.unparse(field.target)}", ast.unparse(field.value)


def main(source: Path) -> None:
    """Print every constant and their number."""
    total = 0
    for package in PACKAGES:
        for path in sorted((source / package).rglob("*.py")):
            found = list(constants(ast.parse(path.read_text())))
            total += len(found)
            for line, name, value in found:
                print(f"{package}/{path.name}:{line}: {name} = {value[:80]}")
    print(f"{total} tuned constants in {', '.join(PACKAGES)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "src" / "reorient")
