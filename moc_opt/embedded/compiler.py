"""The system's C compiler, and a cache of its output, keyed by content."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from moc_opt.errors import MocOptError

# No -march=native: it saves 0.2 of 0.8 us, and without it (and without fused multiply-add, which some
# machines contract to by default) every machine computes the same numbers and may run the same file.
# Never -ffast-math: it drops the checks for NaN.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
_TIME_LIMIT_S = 120


class CompilerError(MocOptError, RuntimeError):
    """There is no C compiler, it failed, or its result cannot be kept."""


def find_compiler() -> list[str]:
    """Return the command in $CC, or else cc, gcc or clang.

    Raises:
        CompilerError: there is none.
    """
    asked = shlex.split(os.environ.get("CC", ""))
    for command in [asked] if asked else (["cc"], ["gcc"], ["clang"]):
        if shutil.which(command[0]) is not None:
            return command
    named = f"CC = {shlex.join(asked)!r} is not on the path" if asked else "neither cc, gcc nor clang is there"
    raise CompilerError(f"no C compiler: {named}; install one (Debian: apt install gcc) or set CC")


def cache_directory() -> Path:
    """Return $XDG_CACHE_HOME/moc_opt, or ~/.cache/moc_opt."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(given) if os.path.isabs(given) else Path.home() / ".cache") / "moc_opt"


def compile_library(files: Mapping[str, str]) -> Path:
    """Compile C sources (name -> text) to a shared library, or find the one compiled before.

    Two processes that compile the same at once both succeed: the library appears in one step.

    Raises:
        CompilerError: no compiler, an error of its, or a cache directory that cannot be written.
    """
    compiler = find_compiler()
    command = [*compiler, *FLAGS, "-shared", "-fPIC"]
    version = _version(*compiler)
    digest = hashlib.sha256()
    for part in (*command, version, platform.machine(), *(text for item in sorted(files.items()) for text in item)):
        digest.update(part.encode() + b"\0")
    folder = cache_directory()
    library = folder / f"moc_tick-{digest.hexdigest()[:24]}.so"
    if library.is_file():
        return library
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            for name, text in files.items():
                Path(scratch, name).write_text(text, encoding="utf-8")
            sources = [name for name in files if name.endswith(".c")]
            _run([*command, *sources, "-lm", "-o", library.name], scratch)
            os.replace(Path(scratch, library.name), library)
    except OSError as error:
        raise CompilerError(
            f"cache {str(folder)!r} cannot be written: {error}; set XDG_CACHE_HOME to a folder of yours"
        ) from error
    return library


@cache
def _version(*compiler: str) -> str:
    return _run([*compiler, "--version"])


def _run(command: list[str], folder: str | None = None) -> str:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_TIME_LIMIT_S)
    except subprocess.TimeoutExpired as error:
        raise CompilerError(f"{shlex.join(command)}: not done after {_TIME_LIMIT_S} s") from error
    if done.returncode != 0:
        raise CompilerError(f"{shlex.join(command)} failed:\n{done.stderr[-2000:]}")
    return done.stdout
