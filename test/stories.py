# SPDX-License-Identifier: Apache-2.0
"""Pages that a user types: what they save and what they run, in order."""

import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_SAVED = re.compile(
    r"[Ss]ave this as `([^`]+)`[^\n]*\n(?:[^\n]+\n)*\n```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
_PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_TYPED = re.compile(
    r"^ {4}(?:impact-observer|(detector|observer|plant|monitor)) ((?:.*\\\n)*.*)$", re.MULTILINE
)


@dataclass(frozen=True)
class Save:
    """A file to be written."""

    name: str
    text: str


@dataclass(frozen=True)
class Run:
    """A command: a node, or else words after ``impact-observer``."""

    node: str
    words: tuple[str, ...]

    @property
    def process(self) -> list[str]:
        """The same as a process of this interpreter."""
        if self.node:
            return [sys.executable, "-m", "impact_observer.ros.entry", self.node, *self.words]
        return [sys.executable, "-m", "impact_observer", *self.words]


@dataclass(frozen=True)
class Python:
    """Code to be executed."""

    text: str


Step = Save | Run | Python


def section(page: str, heading: str) -> str:
    """The text of a page below a heading, up to the next one of the same level."""
    text = (ROOT / page).read_text(encoding="utf-8")
    level = heading.split(maxsplit=1)[0]
    _, found, rest = text.partition(f"\n{heading}\n")
    assert found, f"{page} has no heading {heading}"
    return rest.partition(f"\n{level} ")[0]


def steps(text: str) -> list[Step]:
    """What a user does who types it, in order."""
    found: list[tuple[int, Step]] = []
    found += [(m.start(), Save(m[1], m[2])) for m in _SAVED.finditer(text)]
    found += [(m.start(), Python(m[1])) for m in _PYTHON.finditer(text)]
    for m in _TYPED.finditer(text):
        words = shlex.split(m[2].replace("\\\n", " "), comments=True)
        found.append((m.start(), Run(m[1] or "", tuple(words))))
    return [step for _, step in sorted(found, key=lambda each: each[0])]
