"""The messages of the source, as templates: what is filled in is an ellipsis."""

import ast
import re
from collections.abc import Iterator

ERRORS = {"ReorientError", "StationError", "ProtocolError", "StationHangs", "MissingExtra"}


def template(node: ast.expr) -> str:
    """The text of an expression."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(map(template, values))
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return template(left) + template(right)
    return "…"


def made(node: ast.AST) -> Iterator[str]:
    """The messages that one node makes: of an error, a warning, or the end of a loop."""
    match node:
        case ast.Call(func=ast.Name(id=name), args=[first, *_]) if name in ERRORS:
            yield template(first)
        case ast.Call(func=ast.Name(id="OutOfRange"), args=[name, _, expected]):
            yield f"{template(name)}=…: expected {template(expected)}"
        case ast.Call(func=ast.Name(id="unknown_name"), args=[kind, *_]):
            yield f"unknown {template(kind)} …: expected one of …"
        case ast.Call(func=ast.Name(id="Ended"), args=[_, message, *_]):
            yield template(message)
        case ast.Call(func=ast.Attribute(attr="with_warning"), args=warnings):
            yield from map(template, warnings)
        case ast.Call(func=ast.Attribute(value=listed, attr="append"), args=[text]):
            yield from [template(text)] if ast.unparse(listed).endswith("warnings") else []
        case ast.Assign(targets=[ast.Name(id="warnings")], value=ast.ListComp(elt=text)):
            yield template(text)


def messages(source: str, fewest_words: int = 3) -> set[str]:
    """All messages of a module; with fewer words, most of the text is passed on from elsewhere."""
    found = {tidy(text) for node in ast.walk(ast.parse(source)) for text in made(node)}
    return {text for text in found if len(re.findall(r"[a-zA-Z]{2,}", text.replace("expected", ""))) >= fewest_words}


def tidy(text: str) -> str:
    """Without quotes around what is filled in, and with one ellipsis for several in a row."""
    return re.sub("…+", "…", text.replace("'…'", "…")).strip()
