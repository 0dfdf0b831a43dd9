"""What every benchmark's configuration has: it is read from TOML."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from pathlib import Path
from typing import Self

from benchmarks.output import default_config
from moc_opt.errors import ScenarioError
from moc_opt.settings import Settings


class Configuration(Settings):
    """Base of the configurations in benchmarks/configs/."""

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
        try:
            return cls(**tomllib.loads(path.read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ScenarioError(f"{path}: cannot be used as a configuration: {error}") from error
