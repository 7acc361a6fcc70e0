# SPDX-License-Identifier: Apache-2.0
"""Texts with one mistake each, from tables of mistakes."""


def mistakes(text: str, table: str) -> list[tuple[str, str]]:
    """The ``text`` with the mistake in each line of a ``table``: old, new, key of the error."""
    found = list[tuple[str, str]]()
    for line in table.strip().splitlines():
        old, new, key = (part.strip().replace("\\n", "\n") for part in line.split("|"))
        old = old if old in text else old.replace("\n", "\\n")
        assert text.count(old) == 1, line
        found.append((text.replace(old, new), key))
    return found
