"""Compile the libraries in C; all else of the package is in pyproject.toml.

By the compiler that the environment variable CC names, else by ``cc``. Where there is none, pip
fetches one for the time of the build: Zig's, which compiles C.
"""

import os
import re
import shlex
import shutil
import sys
from hashlib import sha256
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

GIVEN = os.environ.get("CC") or shutil.which("cc")
COMPILER = shlex.split(GIVEN) if GIVEN else [sys.executable, "-m", "ziglang", "cc"]
# No product and sum in one rounding, so that results are the same on every processor
FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared"]


class Compile(build_ext):
    """Compile each extension as a plain shared library, which is for any Python."""

    def build_extension(self, ext: Extension) -> None:
        """Compile the one source of an extension, with its digest."""
        (source,), library = ext.sources, Path(self.get_ext_fullpath(ext.name))
        digest = sha256(Path(source).read_bytes()).hexdigest()
        library.parent.mkdir(parents=True, exist_ok=True)
        self.spawn([*COMPILER, *FLAGS, f'-DSOURCE="{digest}"', source, "-o", str(library)])

    def get_ext_filename(self, fullname: str) -> str:
        """The same name on every platform and for every Python."""
        return f"{fullname.replace('.', '/')}.so"


class Wheel(bdist_wheel):
    """A wheel for any Python, of the platform that it was compiled on.

    On Linux that is any with glibc 2.17 or later: the library needs nothing newer.
    """

    def get_tag(self) -> tuple[str, str, str]:
        """Tags of Python, its ABI and the platform."""
        platform = super().get_tag()[2]
        return "py3", "none", re.sub("^linux_", "manylinux_2_17_", platform)


LIBRARIES = {
    "pipeline.orbit.libclosest": "pipeline/orbit/closest.c",
    "pipeline.networks.refiner.libkernels": "pipeline/networks/refiner/kernels.c",
}

setup(
    ext_modules=[Extension(name, [source]) for name, source in LIBRARIES.items()],
    cmdclass={"build_ext": Compile, "bdist_wheel": Wheel},
    setup_requires=[] if GIVEN else ["ziglang"],
)
