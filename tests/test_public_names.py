"""The signature of `NullSpaceQP` is fixed, and error messages are short and suggest the nearest names."""

import inspect

import pytest

import moc_opt as mo
from moc_opt import errors
from moc_opt.errors import MocOptError, RobotError, TraceError, UnknownNameError


def test_signature_of_the_subproblem_is_unchanged():
    parameters = inspect.signature(mo.NullSpaceQP).parameters
    names = "J_tip J_wrist v_tip v_wrist grad_mu lower upper c0 c1 c2 regularization q pull"
    assert " ".join(parameters) == names
    defaults = {name: p.default for name, p in parameters.items() if p.default is not p.empty}
    assert defaults == {"c0": 0.01, "c1": 0.01, "c2": 0.001, "regularization": 1e-5, "q": None, "pull": None}


@pytest.mark.parametrize("kind", [MocOptError, RobotError, TraceError])
def test_message_of_a_megabyte_is_cut(kind):
    assert str(kind("a field, its value and the cure")) == "a field, its value and the cure"
    assert str(kind("x" * 2000)) == "x" * 2000
    cut = str(kind("begins so " + "x" * 10**6))
    assert (len(cut), cut[:13], cut[-3:]) == (2000, "begins so xxx", "...")


KEYS = ["replay_us", "name", "settings.eps", "settings.eps_rel", "settings.name"]
MANY = [*(f"name_{i}" for i in range(500)), "osqp", "proxqp", "nlp-ipopt"]


@pytest.mark.parametrize(("name", "valid", "words"), [
    ("eps", KEYS, "did you mean 'settings.eps' or 'settings.eps_rel'"),  # a key without its table
    ("nam", KEYS, "did you mean 'name' or 'settings.name'?"), ("setings.eps", KEYS, "did you mean 'settings.eps'"),
    ("name_7x", MANY, "did you mean 'name_7'"), ("proxpq", MANY, "did you mean 'proxqp'? `"),
    ("a", MANY[:3], "valid names: name_0, name_1, name_2"),
])  # fmt: skip
def test_error_lists_the_nearest_names(name, valid, words):
    text = str(UnknownNameError("metric", name, valid, "moc-opt metrics"))
    assert words in text
    assert text.endswith("`moc-opt metrics` lists all 503") == (valid is MANY)
    assert text.count("name_") <= 4  # the wrong name and three near ones


def test_every_error_is_a_moc_opt_error():
    classes = [c for _, c in inspect.getmembers(errors, inspect.isclass) if issubclass(c, Exception)]
    assert len(classes) > 5
    assert all(issubclass(c, MocOptError) for c in classes)
