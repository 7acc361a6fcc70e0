# SPDX-License-Identifier: Apache-2.0
"""The docs as a site."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.long
def test_the_site_is_made_without_a_warning(tmp_path: Path) -> None:
    """Every page is in the menus; equations are mathematics, names have their docstrings."""
    pytest.importorskip("sphinx")
    pytest.importorskip("myst_parser")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", str(ROOT / "docs"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"README"}
    menu = set(re.findall(r'href="([\w/]+)\.html"', (tmp_path / "index.html").read_text()))
    assert pages | {"site/readme", "site/examples", "site/changelog"} <= menu
    assert 'class="math' in (tmp_path / "theory" / "method.html").read_text()
    api = (tmp_path / "api.html").read_text()
    for name in (
        "model.read_model",
        "observer.make_observer",
        "plant.Plant",
        "events.ImpactEvent",
    ):
        assert f'id="impact_observer.{name}"' in api
    assert 'src="../_images/two_mass.png"' in (tmp_path / "site" / "readme.html").read_text()
