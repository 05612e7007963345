"""The hook of mkdocs.yml: a mermaid diagram becomes a picture when the site is built, so the page needs no script."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import mmdr
from pymdownx.superfences import SuperFencesException


def _picture(source: str, *_: Any, **__: Any) -> str:
    try:
        svg = str(mmdr.render(source).svg())
    except Exception as error:
        raise SuperFencesException(f"no diagram: {error}") from error  # others would show the source instead
    width = float(svg.split('viewBox="', 1)[1].split('"')[0].split()[2])
    data = f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
    return f'<div class="diagram"><img alt="diagram" style="width: {width:.0f}px" src="{data}"></div>'


def on_config(config: Any) -> None:
    fence = {"name": "mermaid", "class": "mermaid", "format": _picture}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}
