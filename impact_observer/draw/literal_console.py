# SPDX-License-Identifier: Apache-2.0
"""A console of ``rich`` that prints the control characters of names as escapes."""

from typing import Any

from rich.console import Console
from rich.text import Text

from impact_observer.plain_text import printable_lines


class LiteralConsole(Console):
    """A console that escapes the control characters of what it prints, such as of names."""

    def render_str(self, text: str, **style: Any) -> Text:  # noqa: ANN401 (as its base class has it)
        """Make a text, line by line."""
        return super().render_str(printable_lines(text), **style)
