"""Finished parts: they come back as they were, and only where nothing they depend on changed."""

import numpy as np
import pytest

from benchmarks.common import store as part_store
from benchmarks.common.store import Part, Store
from benchmarks.solver_study.study import SOURCES


def test_what_is_kept_comes_back(tmp_path):
    store = Store(tmp_path)
    key = store.key(solver="osqp", options={"eps": 1e-3}, rows=np.arange(3.0))
    assert store.get(key) is None
    part = Part(
        {"reason": "", "events": ["x"], "nothing": None}, {"x": np.eye(2), "status": np.array(["solved"])}
    )
    store.put(key, part)
    values, arrays = Store(tmp_path).get(key)
    assert values == part.values
    np.testing.assert_array_equal(arrays["x"], np.eye(2))
    assert arrays["status"].tolist() == ["solved"]


def test_a_key_depends_on_everything_asked(tmp_path):
    store = Store(tmp_path)
    base = {"solver": "osqp", "options": {"eps": 1e-3}, "rows": np.arange(3.0)}
    keys = {store.key(**base)}
    for change in ({"solver": "piqp"}, {"options": {"eps": 1e-4}}, {"rows": np.array([0.0, 1.0, 2.1])}):
        keys.add(store.key(**{**base, **change}))
    assert len(keys) == 4
    assert store.key(**base) in keys


def test_other_libraries_or_sources_ask_again(tmp_path, monkeypatch):
    store = Store(tmp_path)
    before = store.key(solver="osqp")
    monkeypatch.setattr(part_store, "circumstances", lambda _: "osqp=2.0")
    assert store.key(solver="osqp") != before


def test_a_damaged_part_counts_as_none(tmp_path):
    store = Store(tmp_path)
    key = store.key(a=1)
    store.put(key, Part({}, {"x": np.ones(2)}))
    (tmp_path / f"{key}.npz").write_bytes(b"torn")
    assert store.get(key) is None
    assert not (tmp_path / f"{key}.npz").exists()


def test_without_a_folder_nothing_is_kept():
    store = Store(None)
    part = Part({}, {"x": np.ones(1)})
    assert store.put("k", part) is part
    assert store.get("k") is None


def test_the_sources_decide_and_have_to_be_there():
    assert Store(None, ("common/timing",)).key(a=1) != Store(None).key(a=1)
    assert Store(None, SOURCES).key(a=1) != Store(None).key(a=1)
    with pytest.raises(FileNotFoundError):
        Store(None, ("common/gone",)).key(a=1)
