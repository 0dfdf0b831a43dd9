"""What every benchmark's configuration has: it is read from TOML."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import ClassVar, Self

from benchmarks.output import default_config
from moc_opt.errors import MocOptError, ScenarioError
from moc_opt.inputs.files import read_toml
from moc_opt.inputs.settings import Settings


class Configuration(Settings):
    """Base of the configurations in benchmarks/configs/."""

    MOST: ClassVar[int] = 1_000_000

    @classmethod
    def chosen(cls, given: Namespace, name: str) -> Self:
        """What the options of ``output.parser`` ask for: the file or the benchmark's own, and its seed.

        Raises:
            MocOptError: the file cannot be used.
        """
        config = cls.load(given.config or default_config(name))
        return config if given.seed is None else config.model_copy(update={"seed": given.seed})

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a TOML file; errors name file and field."""
        table = read_toml(path, "configuration", ScenarioError)
        try:
            return cls(**table)
        except MocOptError as error:
            error.args = (f"{path}: {error}",)
            raise
