# SPDX-License-Identifier: Apache-2.0
"""The docs as a site: ``sphinx-build docs OUT``, or rosdoc2."""

import os
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parent
ROOT = next((p for p in (DOCS.parent, Path.cwd()) if (p / "package.xml").is_file()), DOCS.parent)
"""Of the package: rosdoc2 copies this folder elsewhere, and is run where the package is."""
sys.path.insert(0, str(ROOT))

from impact_observer import __version__  # noqa: E402

project = "impact_observer"
author = "impact_observer developers"
copyright = f"2026, {author}"  # noqa: A001 (Sphinx calls it so)
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
"""Headings down to this level have the anchors that links name."""
exclude_patterns = ["__pycache__", "README.md"]  # its list is the menu
napoleon_use_ivar = True  # attributes of named tuples would stand twice
autodoc_member_order = "bysource"
autodoc_typehints = "description"
html_title = "impact_observer"

_OUTSIDE = {
    DOCS.parent / path: DOCS / "site" / name
    for name, path in {
        "readme.md": "README.md",
        "contributing.md": "CONTRIBUTING.md",
        "quality.md": "QUALITY_DECLARATION.md",
        "changelog.rst": "CHANGELOG.rst",
        "bags.md": "bags/README.md",
        "examples.md": "examples/README.md",
    }.items()
} | {DOCS / "README.md": DOCS / "index.rst"}
"""Pages beside docs/, and what stands for them here: a link, in whose place the page is read."""
_SUFFIXES = (".md", ".rst")
_LINK = re.compile(r"(!?)\[([^]]*)\]\(([^)#:\s]+)(#[^)]*)?\)")


def of_site(app: Sphinx, page: str, source: list[str]) -> None:
    """Pages from outside are read, links lead to pages of the site, the index gets menus."""
    del app
    path = origin = next(each for each in DOCS.glob(f"{page}.*") if each.suffix in _SUFFIXES)
    if path in _OUTSIDE.values():
        origin = next(outside for outside, here in _OUTSIDE.items() if here == path)
        outside = ROOT / origin.relative_to(DOCS.parent)
        source[0] = outside.read_text(encoding="utf-8") if outside.is_file() else source[0]

    def relinked(link: re.Match[str]) -> str:
        image, words, to, anchor = link.groups(default="")
        found = (origin.parent / to).resolve()
        is_page = found in _OUTSIDE or DOCS in found.parents
        if found.is_dir() or (found.suffix in _SUFFIXES and not is_page):
            return words
        place = os.path.relpath(_OUTSIDE.get(found, found), path.parent)
        return f"{image}[{words}]({place}{anchor})"

    if page == "index":
        source[0] += menus()
    elif path.suffix == ".md":
        source[0] = _LINK.sub(relinked, source[0])


def menus() -> str:
    """The reading order of docs/README.md as menus, one for each heading in bold."""
    text, found = (DOCS / "README.md").read_text(encoding="utf-8"), ""
    for part in re.split(r"^\*\*(?=[^*]+\*\*$)", text, flags=re.MULTILINE)[1:]:
        pages = re.findall(r"^\d+\. \[[^]]*\]\(([^)]*)\)", part, re.MULTILINE)
        paths = [DOCS / page for page in pages]
        names = [_OUTSIDE.get(path.resolve(), path).relative_to(DOCS) for path in paths]
        entries = "".join(f"   {name.with_suffix('')}\n" for name in names)
        found += f"\n.. toctree::\n   :caption: {part.partition('**')[0]}\n\n{entries}"
    return found


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", of_site)
