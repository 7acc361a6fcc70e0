"""Installs impact_observer: by colcon as an ament_python package, or by pip."""

import os
import runpy
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import PlatformError

try:
    from pybind11.setup_helpers import ParallelCompile
    from pybind11.setup_helpers import Pybind11Extension as Extension

    ParallelCompile().install()
except ModuleNotFoundError:  # pybind11-dev of Ubuntu has the headers alone, where g++ finds them
    from setuptools import Extension  # type: ignore[no-redef]

NAME = "impact_observer"
SHARE = Path("share", NAME)
KERNEL = Path(NAME, "kernel")
CHECKSUM = runpy.run_path(str(KERNEL / "sources.py"))["checksum"]


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


class BuildKernel(build_ext):  # type: ignore[misc]
    """Builds the kernel; colcon also runs this file where nothing is built."""

    def build_extensions(self) -> None:
        """Strip the kernel, except with --debug.

        Raises:
            PlatformError: the compiler, the headers of Python or those of pybind11 are missing.
        """
        for extension in self.extensions:
            extension.extra_compile_args += ["-O0"] if self.debug else []
            extension.extra_link_args += [] if self.debug else ["-Wl,--strip-all"]
        self._check_compiler()
        if "COLCON" in os.environ:
            self._seek_messages()
        super().build_extensions()

    def _seek_messages(self) -> None:
        """Say where the messages are if no prefix has them: colcon stops at this package.xml."""
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        messages = f"{NAME}_msgs"
        if not any(Path(prefix, "share", messages).is_dir() for prefix in prefixes):
            root = Path(__file__).resolve().parent
            link = f"ln -s {root.name}/msg_defs {root.parent / messages}"
            self.warn(f"{messages} is not found: {link}, then colcon build again")

    def _check_compiler(self) -> None:
        """Let the compiler find the headers of pybind11, which include those of Python."""
        command = [*self.compiler.compiler_cxx, "-E", "-x", "c++", "-"]
        folders = [*self.compiler.include_dirs, *self.extensions[0].include_dirs]
        command += [f"-I{folder}" for folder in folders]
        header = "#include <pybind11/pybind11.h>"
        try:
            done = subprocess.run(
                command, input=header, capture_output=True, text=True, check=False
            )
        except FileNotFoundError:
            raise PlatformError(
                f"no C++ compiler {command[0]}: sudo apt install build-essential"
            ) from None
        if done.returncode:
            missing = "pybind11: pip install pybind11, or sudo apt install pybind11-dev"
            if "Python.h" in done.stderr:
                missing = "Python.h: sudo apt install python3-dev"
            raise PlatformError(f"{command[0]} finds no {missing}")


setup(
    name=NAME,
    version=manifest("version"),
    description=manifest("description"),
    maintainer=manifest("maintainer"),
    license="Apache-2.0",
    python_requires=">=3.10",
    ext_modules=[
        Extension(
            f"{NAME}.kernel._kernel",
            sorted(map(str, KERNEL.glob("*.cpp"))),
            depends=sorted(map(str, KERNEL.glob("*.hpp"))),
            define_macros=[("KERNEL_CHECKSUM", f'"{CHECKSUM(KERNEL)}"')],
            language="c++",
            # The same bits on every processor: no -march, no contraction to fused operations.
            extra_compile_args=[
                *("-std=c++17", "-O2", "-ffp-contract=off"),
                *("-fvisibility=hidden", "-g0", "-Wall", "-Wextra"),
            ],
        )
    ],
    cmdclass={"build_ext": BuildKernel},
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "kernel/*.pyi"]},
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
