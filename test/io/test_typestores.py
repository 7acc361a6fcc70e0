# SPDX-License-Identifier: Apache-2.0
"""Message types."""

from pathlib import Path

import pytest

from impact_observer.errors import BagError
from impact_observer.io import interfaces, typestores


def test_another_definition_of_a_type_is_reported_and_not_used() -> None:
    """Definitions differ by their fields, not by constants or comments."""
    mine = typestores.new_typestore()
    same = "uint8 IMPACT=9  # another remark\nstring contact\nuint8 kind\n"
    typestores.add_definition(mine, same, interfaces.CONTACT_SWITCH)
    other = "string contact\nuint16 kind\n"
    with pytest.raises(BagError, match=f"another definition of {interfaces.CONTACT_SWITCH}"):
        typestores.add_definition(mine, other, interfaces.CONTACT_SWITCH)
    typestores.add_definition(mine, same, interfaces.CONTACT_SWITCH)


def test_definition_in_idl_is_read() -> None:
    """Some bags have definitions in IDL."""
    text = (
        "=" * 80 + "\nIDL: rig/msg/A\nmodule rig { module msg { struct A { int32 value; }; }; };\n"
    )
    assert typestores.parse_definition(text, "rig/msg/A").keys() == {"rig/msg/A"}


def test_installed_definition_brings_its_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Definitions come from the prefixes of a sourced workspace."""
    texts = tmp_path / "share" / "rig" / "msg"
    texts.mkdir(parents=True)
    (texts / "A.msg").write_text("B[] parts\nB[3] three\nfloat64 x\n", "utf-8")
    (texts / "B.msg").write_text("string name\n", "utf-8")
    (texts / "C.msg").write_text("absent/D d\n", "utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f":{tmp_path}")
    definition = typestores.installed_definition("rig/msg/A")
    assert definition is not None
    assert typestores.parse_definition(definition, "rig/msg/A").keys() == {
        "rig/msg/A",
        "rig/msg/B",
    }
    assert typestores.installed_definition("rig/msg/C") is None
    assert typestores.installed_definition("rig/msg/E") is None
