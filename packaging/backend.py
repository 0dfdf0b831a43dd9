"""Build backend: setuptools, with the compiler of the `ziglang` wheel where the system has none."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
from typing import Any

from setuptools import build_meta as _setuptools
from setuptools.build_meta import *  # noqa: F403 - the other hooks are setuptools' own


def _system_compiler() -> bool:
    named = os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc"
    return shutil.which(named.split()[0]) is not None


def _require(hook: Any, settings: Any) -> list[str]:
    return [*hook(settings), *([] if _system_compiler() else ["ziglang>=0.13"])]


def _with_compiler(hook: Any, *arguments: Any) -> Any:
    if not _system_compiler():
        # An explicit target: zig would otherwise take every instruction that this very processor has.
        zig = f"{sys.executable} -m ziglang cc -target {platform.machine()}-linux-gnu"
        os.environ.update(CC=zig, LDSHARED=f"{zig} -shared")
    return hook(*arguments)


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Ask for ziglang only where there is no compiler."""
    return _require(_setuptools.get_requires_for_build_wheel, config_settings)


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Ask for ziglang only where there is no compiler."""
    return _require(_setuptools.get_requires_for_build_editable, config_settings)


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: Any = None) -> str:
    """Build the wheel, its extension module included."""
    return str(_with_compiler(_setuptools.build_wheel, wheel_directory, config_settings, metadata_directory))


def build_editable(wheel_directory: str, config_settings: Any = None, metadata_directory: Any = None) -> str:
    """Build the extension module in place, and the wheel that points here."""
    return str(_with_compiler(_setuptools.build_editable, wheel_directory, config_settings, metadata_directory))
