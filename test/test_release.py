# SPDX-License-Identifier: Apache-2.0
"""What a release needs is there, and says the same everywhere."""

import re
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from impact_observer import __version__

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (ROOT, ROOT / "msg_defs")
METADATA = ("setup.py", "setup.cfg", "pyproject.toml", "CITATION.cff", "CONTRIBUTING.md")
EXAMPLE = "maintainers@example.org"


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_manifest_and_changelog_have_the_version(package: Path) -> None:
    """And what a release of ROS asks for: authors, and headings as in REP-132."""
    manifest = ET.parse(package / "package.xml").getroot()
    name = manifest.findtext("name")
    assert manifest.findtext("version") == __version__
    assert manifest.findtext("author")
    bar, title, same, _, *rest = (package / "CHANGELOG.rst").read_text().splitlines()
    assert (bar, title) == ("^" * len(title), f"Changelog for package {name}")
    assert same == bar
    headings = [(line, below) for line, below in pairwise(rest) if below and set(below) == {"-"}]
    dated = r"(\d+\.\d+\.\d+) \(\d{4}-\d{2}-\d{2}\)"
    versions = [re.fullmatch(dated, heading) for heading, _ in headings]
    assert all(versions)
    assert all(len(heading) == len(below) for heading, below in headings)
    assert versions[0] is not None
    assert versions[0][1] == __version__


def test_nothing_names_an_address_that_cannot_be() -> None:
    """What is not known is left out; the address that ROS demands is an example."""
    files = [*(each / "package.xml" for each in PACKAGES), *map(ROOT.joinpath, METADATA)]
    addresses = {
        address
        for path in files
        for address in re.findall(r"[\w.-]+@[\w.-]+|https?://[^\s\"<>)]+", path.read_text())
    }
    elsewhere = ("http://download.ros.org/", "http://www.w3.org/", "http://www.apache.org/")
    assert {each for each in addresses if not each.startswith(elsewhere)} == {EXAMPLE}
    assert EXAMPLE in (ROOT / "CONTRIBUTING.md").read_text()


def test_the_citation_has_the_version() -> None:
    """Of what is released."""
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_every_optional_package_of_an_error_is_in_an_extra() -> None:
    """What a one-line error says to install, ``pip install '.[EXTRA]'`` brings."""
    extras = (ROOT / "setup.py").read_text()
    named = {
        package
        for path in (ROOT / "impact_observer").rglob("*.py")
        for words in re.findall(r'pip install ([a-z][a-z \-]*)(?:"|,)', path.read_text())
        for package in words.split()
    }
    assert named == {"pyarrow", "joblib", "distributed"}
    for package in named:
        assert f'"{package}>=' in extras
