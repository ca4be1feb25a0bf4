"""What `make docs` adds to these pages: files beside docs/ that they link, the notebook, the help of each verb, and
formulas as MathML, so that the site needs no script from elsewhere."""

import contextlib
import html
import io
import json
import os
import re
from pathlib import Path
from unittest import mock

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from reorient.cli import main
from reorient.cli.verbs import GROUPS

ROOT = Path(__file__).parents[1]
BESIDE = (
    *("RESULTS.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"),
    *("examples/my_station.py", "examples/estimate_from_arrays.py"),
    *("results/reproduce/sweeps/conclusions.md", "src/reorient/estimators/verifier.md"),
)
"""Files outside docs/ that are part of the site."""
WIDTH = "96"  # columns of the help


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the files beside docs/, and the notebooks as pages."""
    for name in BESIDE:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    for path in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=notebook_page(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links as they are in the site; the help of each verb."""
    uri = page.file.src_uri
    if uri == "cli.md":
        markdown += command_line()
    if uri in BESIDE:
        return markdown.replace("](docs/", "](" + "../" * uri.count("/"))
    return markdown.replace("](../", "](").replace(".ipynb)", ".md)")


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Formulas as MathML."""
    content = re.sub(r'<span class="arithmatex">\\\((.*?)\\\)</span>', lambda m: formula(m[1], "inline"), content)
    block = r'<div class="arithmatex">\\\[(.*?)\\\]</div>'
    return re.sub(block, lambda m: f'<div class="formula">{formula(m[1], "block")}</div>', content, flags=re.DOTALL)


def formula(latex: str, display: str) -> str:
    """MathML of a formula that is escaped for HTML."""
    return str(convert(html.unescape(latex).strip(), display=display))


def notebook_page(path: Path) -> str:
    """A notebook as Markdown: its text, its code, and the text that the code printed."""
    parts = []
    for cell in json.loads(path.read_text())["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        printed = "".join("".join(output.get("text", ())) for output in cell.get("outputs", ()))
        parts += [f"```text\n{printed.rstrip()}\n```"] if printed else []
    return "\n\n".join(parts)


def command_line() -> str:
    """Every verb with its help, from the parsers."""
    parts = []
    for group, verbs in GROUPS.items():
        parts.append(f"\n## {group}\n")
        parts += [f"### reorient {name}\n\n```text\n{help_of(name)}\n```\n" for name in verbs]
    return "\n".join(parts)


def help_of(verb: str) -> str:
    """What `reorient VERB --help` prints."""
    printed = io.StringIO()
    with (
        mock.patch.dict(os.environ, COLUMNS=WIDTH),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        main([*verb.split(), "--help"])
    return printed.getvalue().strip()
