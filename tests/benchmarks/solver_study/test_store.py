"""Finished parts: they come back as they were, and only where nothing they depend on changed."""

import numpy as np

from benchmarks.solver_study import store as study_store
from benchmarks.solver_study.store import Part, Store


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
    monkeypatch.setattr(study_store, "circumstances", lambda: "osqp=2.0")
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


def test_the_sources_that_decide_are_there():
    root = study_store.ROOT / "benchmarks"
    assert [name for name in study_store.SOURCES if not (root / f"{name}.py").exists()] == []
