"""`make docs`: the pages as they lie in the checkout, built into one folder; and the hook of mkdocs.yml.

The hook makes a picture of a mermaid diagram when the site is built, so the page needs no script.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from base64 import b64encode
from pathlib import Path
from typing import Any

import mmdr
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import Abort
from pymdownx.superfences import SuperFencesException

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("*.md", "docs/pictures", "docs/evidence", "docs/site.css", "nodes/*.msg", "nodes/*.srv", "nodes/*.action")


def _picture(source: str, *_: Any, **__: Any) -> str:
    try:
        svg = str(mmdr.render(source).svg()).replace("font-size:14px", "font-size:12px")  # it fits in wider fonts too
    except Exception as error:
        raise SuperFencesException(f"no diagram: {error}") from error  # others would show the source instead
    width = float(svg.split('viewBox="', 1)[1].split('"')[0].split()[2])
    data = f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
    return f'<div class="diagram"><img alt="diagram" style="width: {width:.0f}px" src="{data}"></div>'


def on_config(config: Any) -> None:
    fence = {"name": "mermaid", "class": "mermaid", "format": _picture}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace \\| by | in code: in a table GitHub needs the backslash, and here it would be shown."""
    return re.sub(r"`[^`\n]+`", lambda code: code[0].replace("\\|", "|"), markdown)


def main(out: Path) -> int:
    """Build the site into out/docs, from a copy in out/pages; return 1 where a link leads nowhere."""
    pages = out / "pages"
    shutil.rmtree(pages, ignore_errors=True)
    listed = subprocess.run(
        ("git", "ls-files", "-coz", "--exclude-standard", *PARTS), cwd=ROOT, check=True, capture_output=True
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        (pages / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, pages / name)
    config = {"docs_dir": str(pages), "site_dir": str(out / "docs"), "strict": True}
    try:
        build(load_config(str(ROOT / "mkdocs.yml"), **config))
    except Abort as error:
        print(error, file=sys.stderr)
        return 1
    print(f"saved {out / 'docs' / 'index.html'}; with its search: python3 -m http.server -d {out / 'docs'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
