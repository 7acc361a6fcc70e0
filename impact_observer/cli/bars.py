# SPDX-License-Identifier: Apache-2.0
"""The bar at the bottom of the terminal; imported only where there is one, as ``rich`` is slow."""

import time
from collections.abc import Iterable
from typing import TextIO

from rich.console import Console, RenderableType
from rich.progress import BarColumn, ProgressColumn, Task, TaskID
from rich.progress import Progress as RichProgress
from rich.table import Column
from rich.text import Text

_HIDDEN = 0.5
"""Duration of work before anything is shown, s."""
_NUMBERS = 42
"""Columns of the terminal that are kept for a bar and its numbers."""
_NARROW, _WIDE = 10, 40
"""Columns of the bar itself."""


class _Console(Console):
    """A console that never hides the cursor: a killed process could not restore it."""

    def show_cursor(self, show: bool = True) -> bool:
        """Change nothing."""
        del show
        return False


class _Description(ProgressColumn):
    """The description, cut to the width beside the numbers."""

    def __init__(self, console: Console) -> None:
        super().__init__(Column(no_wrap=True))
        self._console = console

    def render(self, task: Task) -> Text:
        text = Text(task.description.replace("\n", " "), no_wrap=True)
        kept = 1 if task.total is None else _NUMBERS
        text.truncate(max(self._console.width - kept, _NARROW), overflow="ellipsis")
        return text


class _ProgressBar(BarColumn):
    """A bar, where there is a total."""

    def render(self, task: Task) -> RenderableType:  # type: ignore[override]
        return Text() if task.total is None else super().render(task)


class _Numbers(ProgressColumn):
    """Amount, share, rate and remaining time."""

    max_refresh = _HIDDEN

    def __init__(self) -> None:
        super().__init__(Column(no_wrap=True))

    def render(self, task: Task) -> Text:
        if task.total is None:
            return Text()
        unit = str(task.fields["unit"])
        return Text("  ".join([_done(task, unit), *_pace(task, unit)]))


def _done(task: Task, unit: str) -> str:
    """``120/4000   3%``; seconds with a decimal."""
    total = task.total or 0
    if unit:
        amount = f"{task.completed:.1f}/{total:.1f} {unit}"
    else:
        amount = f"{task.completed:.0f}/{total:.0f}"
    return f"{amount} {task.percentage:3.0f}%"


def _pace(task: Task, unit: str) -> list[str]:
    """``53.1/s``, of time ``12.4x``, and ``0:01:13``; nothing before there is a rate."""
    if not task.speed:
        return []
    rate = f"{task.speed:.3g}x" if unit == "s" else f"{_short(task.speed)}/s"
    left = task.time_remaining
    if left is None:
        return [rate]
    minutes, seconds = divmod(int(left), 60)
    return [rate, f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"]


def _short(number: float) -> str:
    """Three digits and a prefix."""
    for prefix, size in (("M", 1e6), ("k", 1e3)):
        if number >= size:
            return f"{number / size:.3g}{prefix}"
    return f"{number:.3g}"


class Bars(RichProgress):
    """One bar at a time, or a text without one; drawn by a thread ten times a second."""

    def __init__(self, stream: TextIO) -> None:
        """Draw on a terminal."""
        console = _Console(file=stream, force_terminal=True, highlight=False, markup=False)
        width = _NARROW if console.width < 2 * _NUMBERS else _WIDE
        self._visible = time.monotonic() + _HIDDEN
        self._now: TaskID | None = None
        self._what: str | None = None
        super().__init__(
            _Description(console),
            _ProgressBar(bar_width=width),
            _Numbers(),
            console=console,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def get_renderables(self) -> Iterable[RenderableType]:
        """The line at the bottom, once the work has taken long enough."""
        if time.monotonic() >= self._visible:
            yield self.make_tasks_table(self.tasks)

    def step(self, what: str, done: float, total: float, unit: str) -> None:
        """Show a bar; a new text ``what`` starts a new one."""
        if self._now is None or self._what != what:
            self._begin(what, total, unit)
        if self._now is not None:
            self.update(self._now, completed=done, total=total)

    def show(self, text: str) -> None:
        """Show a text without a bar."""
        if self._now is None or self._what is not None:
            self._begin(None, None, "")
        if self._now is not None:
            self.update(self._now, description=text)

    def line(self, text: str) -> None:
        """Write a line above."""
        self.console.print(text, soft_wrap=True)

    def _begin(self, what: str | None, total: float | None, unit: str) -> None:
        """Replace what is shown."""
        if self._now is not None:
            self.remove_task(self._now)
        self._what = what
        self._now = self.add_task(what or "", total=total, unit=unit)
