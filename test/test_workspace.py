# SPDX-License-Identifier: Apache-2.0
"""A workspace of colcon, built as everybody builds one."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("colcon_core")
pytest.importorskip("rosidl_cmake")

ROOT = Path(__file__).resolve().parents[1]
PREFIX = Path(sys.executable).parents[1]
MISSING = "impact_observer_msgs is not found: ln -s impact_observer/msg_defs "
"""How the line begins that says where the messages are."""

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def clean_environment() -> dict[str, str]:
    """That of a new terminal, in which ``.venv`` is active and no prefix has the messages."""
    bootstrapped = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")  # by rclpy from wheels
    dropped = bootstrapped if bootstrapped[1] in os.environ else ()
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    without = [each for each in prefixes if not Path(each, "share/impact_observer_msgs").is_dir()]
    path = os.pathsep.join((str(PREFIX / "bin"), os.environ["PATH"]))
    return kept | {"AMENT_PREFIX_PATH": os.pathsep.join(without), "PATH": path}


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """This repository in ``src``: two messages suffice."""
    unused = ("bags", "docs", "examples", "test", "build", ".?*", "__pycache__")
    shutil.copytree(ROOT, tmp_path / "src/impact_observer", ignore=shutil.ignore_patterns(*unused))
    listed = tmp_path / "src/impact_observer/msg_defs/CMakeLists.txt"
    others = r"(?m)^  (?:msg|srv)/(?!ContactSwitch|ImpactEvent).*\n"  # ./dev setup builds all
    listed.write_text(re.sub(others, "", listed.read_text("utf-8")), "utf-8")
    return tmp_path


def colcon(folder: Path, *arguments: str, **variables: str) -> str:
    """Runs colcon, and returns what it printed."""
    done = subprocess.run(
        ["colcon", *arguments],
        cwd=folder,
        env=clean_environment() | {"COLCON_HOME": str(folder / "home")} | variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.long
def test_a_plain_colcon_build_names_the_link_that_it_needs_and_builds_both_packages(
    workspace: Path,
) -> None:
    """Without the link colcon does not see the messages; with it both are found and installed."""
    alone = colcon(workspace, "build")
    assert f"{MISSING}{workspace}/src/impact_observer_msgs, then" in alone
    (workspace / "src/impact_observer_msgs").symlink_to("impact_observer/msg_defs")
    mended = f"-DCMAKE_PROJECT_INCLUDE={ROOT}/msg_defs/cmake/drop_missing_includes.cmake"
    python = f"-DPython3_EXECUTABLE={sys.executable}"
    generators = dict.fromkeys(("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"), str(PREFIX))
    wheels = generators if "ROS_DISTRO" not in os.environ else {}
    both = colcon(workspace, "build", "--cmake-args", mended, python, **wheels)
    assert re.findall(r"Finished <<< (\w+)", both) == ["impact_observer_msgs", "impact_observer"]
    assert MISSING not in both
    use = "from impact_observer_msgs.msg import ImpactEvent as E; import impact_observer as o"
    shown = subprocess.run(
        ["bash", "-c", f'. install/setup.bash && python -c "{use}; print(o.__file__, E())"'],
        cwd=workspace,
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert shown.stdout.startswith(str(workspace / "install/impact_observer/lib")), shown.stderr
    assert (workspace / "install/impact_observer/lib/impact_observer/observer").is_file()


@pytest.mark.parametrize("place", ["workspace", "clone"])
def test_colcon_lists_both_packages(workspace: Path, place: str) -> None:
    """In a workspace by the link, in a clone by the file of defaults."""
    pytest.importorskip("colcon_package_information")
    pytest.importorskip("colcon_defaults")
    source, defaults = workspace / "src/impact_observer", {}
    (workspace / "src/impact_observer_msgs").symlink_to("impact_observer/msg_defs")
    if place == "clone":
        defaults = {"COLCON_DEFAULTS_FILE": str(source / "colcon_defaults.yaml")}
    listed = colcon(source if defaults else workspace, "list", "--names-only", **defaults)
    assert listed.split() == ["impact_observer", "impact_observer_msgs"]
