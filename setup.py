"""Installs impact_observer: by colcon as an ament_python package, or by pip."""

import os
from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

NAME = "impact_observer"
SHARE = Path("share", NAME)


def manifest(tag: str) -> str:
    """Returns a text of package.xml, the one place of version and description."""
    text = ET.parse("package.xml").getroot().findtext(tag, default="")
    return " ".join(text.split())


def requirements(name: str) -> list[str]:
    """Returns the packages of requirements/<name>.txt."""
    folder = Path(__file__).resolve().parent / "requirements"  # colcon links to this file only
    lines = (folder / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def shared(*roots: str) -> list[tuple[str, list[str]]]:
    """Returns the data_files entries that install every file below roots, as it lies, to SHARE."""
    files = sorted(path for root in roots for path in Path(root).rglob("*") if path.is_file())
    folders = sorted({path.parent for path in files if path.parent.name != "__pycache__"})
    return [
        (str(SHARE / folder), [str(path) for path in files if path.parent == folder])
        for folder in folders
    ]


class BuildPackage(build_py):  # type: ignore[misc]
    """Copies the modules."""

    def run(self) -> None:
        """Say where the messages are if no prefix has them: colcon stops at this package.xml."""
        super().run()
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        messages = f"{NAME}_msgs"
        is_found = any(Path(prefix, "share", messages).is_dir() for prefix in prefixes)
        if "COLCON" in os.environ and not is_found:
            root = Path(__file__).resolve().parent
            link = f"ln -s {root.name}/msg_defs {root.parent / messages}"
            self.warn(f"{messages} is not found: {link}, then colcon build again")


setup(
    name=NAME,
    version=manifest("version"),
    description=manifest("description"),
    maintainer=manifest("maintainer"),
    license="Apache-2.0",
    python_requires=">=3.10",
    cmdclass={"build_py": BuildPackage},
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (str(SHARE), ["package.xml"]),
        *shared("launch", "config", "layouts", "bags", "msg_defs/msg", "msg_defs/srv"),
    ],
    install_requires=requirements("run"),
    extras_require={
        "parquet": ["pyarrow>=14"],
        "robots": requirements("robots"),
        "sweep": ["joblib>=1.4", "pyarrow>=14"],
        "dask": ["distributed>=2023.8", "joblib>=1.4", "pyarrow>=14"],
        "test": requirements("test"),
        "docs": requirements("docs"),
        "dev": [*requirements("test"), *requirements("lint"), *requirements("docs")],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "impact-observer = impact_observer.cli.main:main",
            "plant = impact_observer.ros.entry:plant",
            "detector = impact_observer.ros.entry:detector",
            "observer = impact_observer.ros.entry:observer",
            "monitor = impact_observer.ros.entry:monitor",
        ],
    },
)
