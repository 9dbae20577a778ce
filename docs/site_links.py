"""A hook of the site: what leads out of it stays in it, for it is read without a network.

Links from docs/ to files of the repository outside of it lead nowhere on the site.
Where the file is a page of the site, the link stays. A link to code, scenes or the changelog becomes its
path in the repository, as text: the site is read without a network. A link to a file that does not exist
is an error.
"""

import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError

_TOP = Path(__file__).resolve().parent.parent
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((\.\./[^)#\s]+)(?:#[^)]*)?\)")
_SEARCH = _TOP / "docs" / "site_search.js"
_ROLE = re.compile(r":(?:class|func|mod|attr|meth|data|exc):(?=<|`)")
_FROM_NETWORK = re.compile(r'<script src="https?://[^"]*"></script>')


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace links that leave the site."""
    folder = (_TOP / "docs" / page.file.src_path).parent

    def replaced(match: re.Match[str]) -> str:
        target = (folder / match[2]).resolve()
        if not target.exists():
            raise PluginError(f"{page.file.src_path}: no file {match[2]}")
        if target.is_relative_to(_TOP / "docs"):
            return match[0]
        return f"{match[1]} (`{target.relative_to(_TOP)}`)"

    return _LINK.sub(replaced, markdown)


def on_post_page(output: str, **_: Any) -> str:
    """Put a script of our own for the one that searches in pages opened as files, from the network."""
    # What introduces a block of code in a docstring is no text of the page.
    output = output.replace("<p>::</p>", "").replace("::</p>", ":</p>")
    # Roles of reStructuredText in docstrings: `:class:` before a name.
    output = _ROLE.sub("", output)
    ours = f"<script>{_SEARCH.read_text(encoding='utf-8')}</script>"
    return _FROM_NETWORK.sub(lambda _: ours, output)


def on_post_template(output_content: str, **_: Any) -> str:
    """The same for the page of an address that is not there."""
    return on_post_page(output_content)
