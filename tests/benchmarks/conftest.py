"""A tiny run of a study, from its TOML to its files, with its jobs in this process; tests/study has the engine."""

import json
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import polars as pl
import pytest

from moc_opt.errors import MocOptError, describe
from moc_opt.study import Failed, Job


@dataclass(frozen=True)
class Left:
    """What a command left in its folder."""

    out: Path
    config: Any

    @property
    def summary(self) -> Any:
        return json.loads((self.out / "summary.json").read_text(encoding="utf-8"))

    @property
    def rows(self) -> list[dict[str, Any]]:
        return pl.read_parquet(self.out / "rows.parquet").to_dicts()


def in_this_process(jobs: Sequence[Job], *, done: Callable[[Job, Any], None], **options: Any) -> list[Any]:
    """Do what `moc_opt.study.run` does; arguments and results pickle all the same."""
    results = list[Any]()
    for job in jobs:
        try:
            work, arguments = pickle.loads(pickle.dumps((job.work, job.arguments)))
            results.append(pickle.loads(pickle.dumps(work(*arguments))))
        except MocOptError as error:
            results.append(Failed("raised", describe(error)))
        done(job, results[-1])
    return results


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Left]:
    """A function that runs a study's command on a configuration with seed 3."""

    def run(study: ModuleType, text: str, *options: str) -> Left:
        folder = tmp_path_factory.mktemp(study.__name__)
        file, out = folder / "tiny.toml", folder / "out"
        file.write_text(text, encoding="utf-8")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("moc_opt.study.command.run", in_this_process)
            assert study.main([str(file), "--out", str(out), "--seed", "3", *options]) == 0
        return Left(out, study.Config.load(file).model_copy(update={"seed": 3}))

    return run
