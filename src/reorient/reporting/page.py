"""The frame of every page: one HTML file without external resources."""

from html import escape

_STYLE = """
:root { --ink: #20242c; --soft: #5b6270; --line: #e4e7ec; --accent: #2f6db5; }
* { box-sizing: border-box; }
body { margin: 0; background: #f6f7f9; color: var(--ink);
  font: 15px/1.55 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 40px 28px 64px; }
h1 { font-size: 27px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -0.01em; }
h2 { font-size: 18px; margin: 0 0 14px; }
h3 { font-size: 14px; margin: 22px 0 10px; color: var(--soft); font-weight: 600; }
.lead { color: var(--soft); margin: 0 0 26px; font-size: 16px; }
section { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 22px 24px; margin: 0 0 20px; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 10px; text-align: right; white-space: nowrap; }
th { color: var(--soft); font-weight: 600; border-bottom: 2px solid var(--line); }
th.word, td.word { text-align: left; }
td.word { white-space: normal; min-width: 12em; }
tr.begins td { border-top: 1px solid var(--line); }
tbody tr:hover td { background-color: #f2f6fb; }
td.bar { background-image: linear-gradient(#d7e6f7, #d7e6f7); background-repeat: no-repeat;
  background-position: 0 center; background-size: var(--share) 72%; }
.note { color: var(--soft); font-size: 13px; margin: 12px 0 0; }
img { display: block; max-width: 100%; height: auto; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(440px, 1fr)); gap: 16px; }
figure { margin: 0; }
figure.dark img { border-radius: 8px; }
figcaption { font-size: 13px; color: var(--soft); padding: 7px 2px 0; }
figcaption b { color: var(--ink); }
pre { margin: 0; font: 12.5px/1.5 ui-monospace, Menlo, Consolas, monospace;
  white-space: pre-wrap; overflow-wrap: anywhere; }
"""


def page(title: str, lead: str, sections: dict[str, str]) -> str:
    """A complete HTML document; title, lead and headings are text, the bodies of the sections HTML."""
    body = "".join(f"<section><h2>{escape(heading)}</h2>{content}</section>\n" for heading, content in sections.items())
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n"
        f'<body><main><h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>\n{body}</main></body></html>\n'
    )


def inline_image(data_uri: str, alt: str, caption: str = "", dark: bool = False) -> str:
    """A figure with an embedded image. ``alt`` is text, ``caption`` HTML; ``dark``: for pictures, not charts."""
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    kind = ' class="dark"' if dark else ""
    return f'<figure{kind}><img src="{data_uri}" alt="{escape(alt)}">{below}</figure>'
