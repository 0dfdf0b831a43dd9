"""The base of every benchmark's configuration, which is read from TOML."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field

from benchmarks.common.output import default_config, environment
from moc_opt.errors import MocOptError, ScenarioError, SolverError, UnknownNameError
from moc_opt.inputs.files import read_toml
from moc_opt.inputs.settings import Settings
from moc_opt.solvers import available


class Configuration(Settings):
    """Base of the configurations in benchmarks/configs/."""

    MOST: ClassVar[int] = 1_000_000
    KIND: ClassVar[str] = "configuration:"
    seed: int = Field(0, ge=0)

    @classmethod
    def chosen(cls, given: Namespace, name: str) -> Self:
        """Return what the options of ``cli.parser`` ask for: the file or the benchmark's own, its seed, less data.

        Raises:
            MocOptError: the file cannot be used.
        """
        config = cls.load(given.config or default_config(name))
        if given.seed is not None:
            config = config.model_copy(update={"seed": given.seed})
        return config.quick() if given.quick else config

    def quick(self) -> Self:
        """Return the same on less data: for a first look and for the tests."""
        raise NotImplementedError

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a TOML file; errors name file and field."""
        table = read_toml(path, "configuration", ScenarioError)
        try:
            return cls(**table)
        except MocOptError as error:
            error.args = (f"{path}: {error}",)
            raise

    def environment(self, given: Namespace, **remarks: Any) -> dict[str, Any]:
        """Return what environment.json holds after a run with this configuration."""
        return environment(self.model_dump(mode="json"), self.seed, given.argv) | remarks


def runnable(wanted: Literal["all"] | Sequence[str], *beside: str) -> list[str]:
    """Name the solvers of a benchmark; "all" are those that can run here.

    Args:
        beside: further names, such as that of a baseline.

    Raises:
        UnknownNameError: no such solver.
        SolverError: one that is asked for by name cannot run here, and why.
    """
    found = {**dict.fromkeys(beside), **available()}
    if wanted == "all":
        return [name for name, why in found.items() if why is None]
    for name in wanted:
        if name not in found:
            raise UnknownNameError("solver", name, found, "moc-opt solvers --list")
        if found[name] is not None:
            raise SolverError(f"solver {name!r} cannot run here: {found[name]}")
    return list(wanted)
