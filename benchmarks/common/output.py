"""The files of every benchmark: summary.json, rows.parquet, environment.json, and the report."""

from __future__ import annotations

import datetime
import importlib.metadata
import io
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moc_opt.inputs.files import plain, to_json, write_whole

if TYPE_CHECKING:
    import polars as pl

    from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

PACKAGES = (
    "moc-opt", "numpy", "pin", "mujoco", "casadi", "osqp", "proxsuite", "qpsolvers", "daqp", "piqp",
    "quadprog", "clarabel", "scs", "highspy", "polars", "pydantic", "tsid", "pin-pink", "mink",
)  # fmt: skip

Summary = Mapping[str, Mapping[str, Mapping[str, Any]]]


def save_page(page: Page, path: Path, *, figures: bool = False) -> None:
    """Save a report, and with ``figures`` every figure of it as a file beside it.

    Raises:
        BrowserError: no browser that could draw them; the page is saved all the same.
    """
    page.save(path)
    if figures:
        from moc_opt.report.export import save_figures

        save_figures(page.figures, path.parent / "figures")


def default_config(name: str) -> Path:
    """Return the configuration that ships with a benchmark."""
    return Path(__file__).parents[1] / "configs" / f"{name}.toml"


def write_atomically(path: Path, data: bytes) -> None:
    """Write all of it or nothing, also when the machine stops in the middle; the folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, data)


def write_json(path: Path, value: Any) -> None:
    """Write it sorted, so that two runs can be compared by eye."""
    write_atomically(path, (to_json(value, sort_keys=True) + "\n").encode())


def write_rows(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write one Parquet row per mapping; a column that a row lacks is null there, and so is what is not finite."""
    import polars as pl

    kept = [plain(row) for row in rows]
    names = list(dict.fromkeys(name for row in kept for name in row))
    frame = pl.DataFrame([pl.Series(name, [row.get(name) for row in kept], strict=False) for name in names])
    write_atomically(path, parquet_bytes(frame))


def parquet_bytes(frame: pl.DataFrame) -> bytes:
    """Make a Parquet file in memory."""
    packed = io.BytesIO()
    frame.write_parquet(packed, compression="zstd")
    return packed.getvalue()


def close_page(
    page: Page, command: str, environment: Mapping[str, Any], rows: Iterable[Mapping[str, Any]], keys: Sequence[str]
) -> None:
    """End a report: the rows with an ``error``, by these keys, and what made the page, on which machine.

    Args:
        command: of ``python -m benchmarks.COMMAND``.
        environment: see `environment`.
        rows: of the benchmark; one that went wrong has a text as its ``error``.
        keys: columns that identify a row.
    """
    failed = [row for row in rows if row["error"]]
    if failed:
        page.section("Trials that failed")
        page.table(Table("Errors", [Column(key, key) for key in (*keys, "error")], failed))
    page.section("Made by")
    machine = environment["machine"]
    page.text(
        f"`python -m benchmarks.{command}`, seed {environment['seed']}, commit {environment['commit']}, "
        f"{machine['cores']} cores, {machine['processor']}, load {machine['load_1min']:.1f}."
    )


def environment(config: Mapping[str, Any], seed: int, argv: Sequence[str] = ()) -> dict[str, Any]:
    """Return the machine, versions, commit, seed and the whole configuration."""
    versions: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "when": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "machine": {
            "system": platform.platform(), "processor": _processor(), "cores": os.cpu_count(),
            "python": platform.python_version(), "load_1min": os.getloadavg()[0],
        },
        "threads": os.environ.get("OMP_NUM_THREADS"),
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),  # another kernel rounds otherwise
        "versions": versions,
        "commit": _commit(),
        "seed": seed,
        "arguments": list(argv),
        "config": dict(config),
    }  # fmt: skip


def _processor() -> str:
    cpu = Path("/proc/cpuinfo")
    if cpu.exists():
        for line in cpu.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()


def _commit() -> str | None:
    """Return the commit of this checkout, marked where files differ from it; None outside a checkout."""
    where = Path(__file__).parent
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=where, capture_output=True, text=True, check=True)
        dirty = subprocess.run(
            ["git", "status", "--porcelain", "-uno"], cwd=where, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+changes" if dirty.stdout.strip() else "")
