"""Parts of the site that are made when it is built: keys of scene files, pages from elsewhere, pictures of scripts."""

import os
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from scene_keys import scene_keys
from sphinx.util.docutils import SphinxDirective
from sphinx_gallery.scrapers import figure_rst

DOCS = Path(__file__).parent
ROOT = DOCS.parent
# Pages that stand elsewhere in the repository, and where the site has them.
OUTSIDE = {
    "README.md": "docs/outside/readme.md",
    "CHANGELOG.md": "docs/outside/changelog.md",
    "CONTRIBUTING.md": "docs/outside/contributing.md",
    **{
        f"benchmarks/results/{path.name}": f"docs/outside/{path.name}"
        for path in sorted((ROOT / "benchmarks" / "results").glob("*.md"))
    },
}


class SceneKeys(SphinxDirective):
    """The directive `scene-keys`: a table for every model of a scene file."""

    def run(self) -> list[nodes.Node]:
        """Tables as nodes."""
        return self.parse_text_to_nodes(scene_keys(), allow_section_headings=True)


def with_links(text: str, page: str, shown: str) -> str:
    """A page whose links to pages from elsewhere lead to where the site has them.

    Parameters
    ----------
    text : Markdown
    page : where it stands, relative to the repository; links count from there
    shown : where the site has it
    """

    def link(match: re.Match) -> str:
        target, anchor = match.group(1), match.group(2) or ""
        if "://" in target:
            return match.group(0)
        found = os.path.normpath(os.path.join(os.path.dirname(page), target))
        return f"]({os.path.relpath(OUTSIDE.get(found, found), os.path.dirname(shown))}{anchor})"

    return re.sub(r"\]\(([^)#\s]+)(#[^)\s]*)?\)", link, text)


def copy_outside() -> None:
    """Copy pages from elsewhere; one that has not changed is left alone, so that it is not built again."""
    (DOCS / "outside").mkdir(exist_ok=True)
    for page, shown in OUTSIDE.items():
        text, target = with_links((ROOT / page).read_text(encoding="utf-8"), page, shown), ROOT / shown
        if not target.exists() or target.read_text(encoding="utf-8") != text:
            target.write_text(text, encoding="utf-8")


def lead_links(app: Any, name: str, source: list[str]) -> None:
    """Mend the links of a page that Sphinx has read."""
    page = f"docs/{name}.md"
    if page not in OUTSIDE.values() and (ROOT / page).exists():
        source[0] = with_links(source[0], page, page)


def describe_below_names(_app: Any, _what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Move the descriptions of parameters below their names.

    Docstrings have `name : description`, because types stand in the signature; numpydoc would show the description as a
    type.
    """
    out, inside = [], False
    for i, line in enumerate(lines):
        below = lines[i + 1] if i + 1 < len(lines) else ""
        if line and set(below.strip()) == {"-"}:
            inside = line.strip() in ("Parameters", "Attributes", "Other Parameters")
        name, colon, description = line.partition(" : ")
        if inside and colon and not line.startswith(" "):
            out += [name, f"    {description}"]
        else:
            out.append(line)
    lines[:] = out


class QuickArguments:
    """The command line that example scripts see: `--quick`."""

    def __call__(self, *_: Any) -> list[str]:
        """Arguments of one script."""
        return ["--quick"]

    def __repr__(self) -> str:
        """The same in every build, so that pages are not built anew."""
        return "QuickArguments()"


class WrittenPictures:
    """Pictures that a block of a script has written, for its page.

    Parameters
    ----------
    folder : where scripts run; PNG files below it count
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seen: set[Path] = set()

    def __repr__(self) -> str:
        """The same in every build, so that pages are not built anew."""
        return "WrittenPictures()"

    def __call__(self, block: Any, block_vars: dict, gallery_conf: dict) -> str:
        """Copy new pictures to the gallery; returns the text that shows them."""
        found = []
        for path in sorted(set(self.folder.rglob("*.png")) - self.seen):
            self.seen.add(path)
            target = Path(next(block_vars["image_path_iterator"]))
            target.write_bytes(path.read_bytes())
            found.append(str(target))
        return figure_rst(found, gallery_conf["src_dir"])
