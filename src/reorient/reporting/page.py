"""The frame of every page: one HTML file without external resources, and the data that its script shows."""

import json
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from reorient.runs.files import replacing

_SCRIPTS = ("three.min.js", "images.js", "view3d.js", "charts.js", "page.js")
_NO_SCRIPT = "The 3D view and the charts of this page need JavaScript. The texts and tables do not."


def page(title: str, lead: str, sections: Mapping[str, str], data: Mapping[str, Any] | None = None) -> str:
    """A complete HTML document; title, lead and headings are text, the bodies of the sections HTML.

    ``data``: what the script draws into the elements of ``part``, as JSON; None: a page without a script.
    """
    body = "".join(f"<section><h2>{escape(heading)}</h2>{content}</section>\n" for heading, content in sections.items())
    scripts = "" if data is None else f"<noscript><p>{_NO_SCRIPT}</p></noscript>{_scripts(data)}"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_web('page.css')}</style></head>\n"
        f'<body><main><div class="top"><h1>{escape(title)}</h1></div><p class="lead">{escape(lead)}</p>\n'
        f"{body}</main>{scripts}</body></html>\n"
    )


def write_page(
    path: Path, title: str, lead: str, sections: Mapping[str, str], data: Mapping[str, Any] | None = None
) -> Path:
    """Write ``page(...)`` to a file; returns its path. Raises ReorientError where it cannot be written."""
    with replacing(path) as temporary:
        temporary.write_text(page(title, lead, sections, data), encoding="utf-8", errors="backslashreplace")
    return path


def part(name: str, label: str = "") -> str:
    """The place of a part that the script draws: view, curve, images, filter, charts, rows, pair or trials."""
    kind = f' class="{name}"' if name in ("images", "charts") else ""
    return f'{f"<p class=note>{escape(label)}</p>" if label else ""}<div data-part="{name}"{kind}></div>'


def wide(table: str, label: str) -> str:
    """A table (HTML) that scrolls by itself where it is too wide, by keyboard, too; ``label`` is text."""
    return f'<div class="wide" tabindex="0" role="region" aria-label="{escape(label)}">{table}</div>'


def table(headings: Sequence[str], lines: Iterable[Sequence[str]], words: Container[int], label: str) -> str:
    """A table of texts; the columns ``words`` are set to the left, the others, numbers, to the right."""

    def row(cells: Sequence[str], tag: str) -> str:
        sides = [' class="word"' if index in words else "" for index in range(len(cells))]
        return "<tr>" + "".join(f"<{tag}{s}>{escape(c)}</{tag}>" for s, c in zip(sides, cells, strict=True)) + "</tr>"

    body = "".join(row(line, "td") for line in lines)
    return wide(f"<table><thead>{row(headings, 'th')}</thead><tbody>{body}</tbody></table>", label)


def inline_image(data_uri: str, alt: str, caption: str = "", kind: str = "plot") -> str:
    """A figure with an embedded image. ``alt`` is text, ``caption`` HTML; ``kind``: dark for pictures, plot for charts
    on white."""
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    return f'<figure class="{kind}"><img src="{data_uri}" alt="{escape(alt)}">{below}</figure>'


def _scripts(data: Mapping[str, Any]) -> str:
    """The data, in which no text can end its element, and the scripts."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    code = "".join(f"<script>{_web(name)}</script>\n" for name in _SCRIPTS)
    return f'<script type="application/json" id="data">{text}</script>\n{code}'


@cache
def _web(name: str) -> str:
    return files("reorient.reporting").joinpath("web", name).read_text(encoding="utf-8")
