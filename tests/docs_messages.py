"""The messages of the source, as templates: what is filled in is an ellipsis."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ERRORS = {"ReorientError", "StationError", "ProtocolError", "StationHangs"}


def template(node: ast.expr) -> str:
    """The text of an expression."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(template(value) for value in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return template(left) + template(right)
    return "…"


def messages(tree: ast.Module) -> Iterator[str]:
    """Of errors that are made, and of warnings that are added; a text that is passed on is none of its own."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Name(id=name), args=[first, *rest]):
                if name in ERRORS:
                    yield template(first)
                elif name == "OutOfRange" and len(rest) == 2:
                    yield f"{template(first)}=…: expected {template(rest[1])}"
                elif name == "unknown_name":
                    yield f"unknown {template(first)} …: expected one of …"
                elif name == "Mistake" and len(rest) == 2:
                    yield template(rest[0])
            case ast.Call(func=ast.Attribute(attr="with_warning"), args=args):
                yield from map(template, args)
            case ast.Call(func=ast.Attribute(value=listed, attr="append"), args=[text]):
                if ast.unparse(listed).endswith("warnings"):
                    yield template(text)
            case ast.Assign(targets=[ast.Name(id="warnings")], value=ast.List(elts=texts) | ast.ListComp(elt=ast.expr() as elt)):
                yield from map(template, texts)
            case ast.Assign(targets=[ast.Name(id="message" | "words")], value=value):
                yield ""
