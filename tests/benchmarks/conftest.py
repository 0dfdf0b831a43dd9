"""The fixture `tiny` runs a small study without worker processes."""

import json
import pickle
from collections.abc import Callable, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any

import polars as pl
import pytest

from moc_opt.errors import MocOptError, describe
from moc_opt.study import Failed, Job


def in_this_process(jobs: Sequence[Job], *, done: Callable[[Job, Any], None], **options: Any) -> list[Any]:
    """Stand in for `moc_opt.study.run`, with pickled arguments and results."""
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
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., SimpleNamespace]:
    def run(study: ModuleType, text: str, *options: str) -> SimpleNamespace:
        folder = tmp_path_factory.mktemp(study.__name__)
        file, out = folder / "tiny.toml", folder / "out"
        file.write_text(text, encoding="utf-8")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("moc_opt.study.command.run", in_this_process)
            assert study.main([str(file), "--out", str(out), "--seed", "3", *options]) == 0
        return SimpleNamespace(
            out=out, config=study.Config.load(file).model_copy(update={"seed": 3}),
            summary=json.loads((out / "summary.json").read_text(encoding="utf-8")),
            rows=pl.read_parquet(out / "rows.parquet").to_dicts(),
        )  # fmt: skip

    return run
