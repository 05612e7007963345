"""The hook of mkdocs.yml: a mermaid diagram becomes a picture when the site is built, so the page needs no script."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import mmdr


def _picture(source: str, *_: Any, **__: Any) -> str:
    data = b64encode(mmdr.render(source).svg.encode()).decode()
    return f'<div class="diagram"><img alt="diagram" src="data:image/svg+xml;base64,{data}"></div>'


def on_config(config: Any) -> None:
    fence = {"name": "mermaid", "class": "mermaid", "format": _picture}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}
