"""Metadata that a distribution has and a clone has not: the README with absolute links.

In a clone README.md links to the files beside it. On a page of a package index, and in an installed
distribution, these files are not there: every relative link and picture becomes one below the
repository that pyproject.toml names, at the head of its default branch.
"""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

PICTURES = (".png", ".gif", ".svg", ".jpg")
_LINK = re.compile(r"(?<=\]\()(?!https?://|#|mailto:)([^)\s]+)(?=\))")


def absolute(text: str, repository: str) -> str:
    """Markdown whose links hold outside the repository; repository: its address, without a slash.

    Links to headings of the page itself, and blocks of code, stay as they are.
    """

    def replaced(match: re.Match[str]) -> str:
        target = match[1].removeprefix("./")
        kind = "raw" if target.lower().endswith(PICTURES) else "blob"
        return f"{repository}/{kind}/HEAD/{target}"

    parts = re.split(r"(^```.*?^```)", text, flags=re.DOTALL | re.MULTILINE)
    return "".join(part if part.startswith("```") else _LINK.sub(replaced, part) for part in parts)


class ReadmeHook(MetadataHookInterface):
    """Called by hatchling where [tool.hatch.metadata.hooks.custom] stands in pyproject.toml."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Put the README into the metadata."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        text = absolute(text, metadata["urls"]["Repository"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
