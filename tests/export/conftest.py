"""Fixtures for exported folders."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from moc_opt.export import export_scenario
from moc_opt.export.folder import CORE
from moc_opt.scenario import Scenario

FLAGS = "CFLAGS=-std=c11 -ffp-contract=off -fno-math-errno -Werror -fPIC -O3"
Export = Callable[..., Path]


def make(place: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["make", "-C", place, *words], capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """Export scenarios. The core is compiled once."""
    if shutil.which("make") is None or shutil.which("cc") is None:
        pytest.skip("no make or cc")
    core: list[Path] = []
    objects = [name.replace(".c", ".o") for name in CORE if name.endswith(".c")]

    def export(scenario: Scenario, udp: bool = False) -> Path:
        out = tmp_path_factory.mktemp("exported")
        assert sorted(export_scenario(scenario, out, udp=udp)) == sorted(out.iterdir())
        for file in core:
            shutil.copy(file, out)
        done = make(out, FLAGS, *objects)
        assert done.returncode == 0, done.stdout + done.stderr
        assert ("-Wconversion" in done.stdout) == (not core), "the core is compiled once"
        core[:] = [out / name for name in objects]
        return out

    return export
