"""TOML that is written is read again as the same table."""

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.inputs.toml import to_toml

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
VALUES = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(TEXT, VALUES, max_size=4))
def test_what_is_written_is_read(table):
    assert tomllib.loads(to_toml(table)) == table


def test_numpy_s_values_are_numbers():
    assert tomllib.loads(to_toml({"a": np.float64(0.1), "b": np.arange(3)})) == {"a": 0.1, "b": [0, 1, 2]}


def test_none_is_refused_by_its_key():
    with pytest.raises(TypeError, match=r"a\.b = None has no form in TOML"):
        to_toml({"a": {"b": None}})
