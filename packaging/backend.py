"""Build backend: setuptools, with the compiler of the `ziglang` wheel if the system has none."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from setuptools import build_meta as _setuptools
from setuptools.build_meta import *  # noqa: F403 - the other hooks are setuptools' own


def _system_compiler() -> bool:
    if "CC" in os.environ:
        return True  # if the compiler in CC is missing, the build fails and names it
    return shutil.which((sysconfig.get_config_var("CC") or "cc").split()[0]) is not None


def _require(hook: Any, settings: Any) -> list[str]:
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise SystemExit(
            f"moc_opt has an extension module, and {sys.executable} has no Python.h to compile it with: install the "
            "headers (Debian and Ubuntu: python3-dev, Fedora: python3-devel), or a wheel of moc_opt"
        )
    return [*hook(settings), *([] if _system_compiler() else ["ziglang>=0.13"])]


def _with_compiler(hook: Any, *arguments: Any) -> str:
    if _system_compiler():
        return str(hook(*arguments))
    # Without a target, zig would compile for the processor and the C library of this machine.
    zig = f"{shlex.quote(sys.executable)} -m ziglang cc -target {platform.machine()}-linux-gnu.2.28"
    with tempfile.TemporaryDirectory() as cache:
        os.environ.update(CC=zig, LDSHARED=f"{zig} -shared", ZIG_GLOBAL_CACHE_DIR=cache)
        return str(hook(*arguments))


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Ask for ziglang only if there is no compiler."""
    return _require(_setuptools.get_requires_for_build_wheel, config_settings)


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Ask for ziglang only if there is no compiler."""
    return _require(_setuptools.get_requires_for_build_editable, config_settings)


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: Any = None) -> str:
    """Build the wheel."""
    return _with_compiler(_setuptools.build_wheel, wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory: str, config_settings: Any = None, metadata_directory: Any = None) -> str:
    """Build the extension module in place."""
    return _with_compiler(_setuptools.build_editable, wheel_directory, config_settings, metadata_directory)
