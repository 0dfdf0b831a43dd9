"""Messages stay short, whatever a file holds."""

import pytest

from moc_opt.errors import MocOptError, RobotError, TraceError, UnknownNameError


@pytest.mark.parametrize("kind", [MocOptError, RobotError, TraceError])
def test_a_text_of_a_megabyte_is_cut(kind):
    assert str(kind("a field, its value and the cure")) == "a field, its value and the cure"
    assert str(kind("x" * 2000)) == "x" * 2000
    cut = str(kind("begins so " + "x" * 10**6))
    assert len(cut) == 2000
    assert cut.startswith("begins so xxx")
    assert cut.endswith("...")


def test_a_key_without_its_table_is_found_by_its_last_part():
    valid = ["replay_us", "name", "settings.eps", "settings.eps_rel", "settings.name"]
    assert "did you mean 'settings.eps' or 'settings.eps_rel'" in str(UnknownNameError("key", "eps", valid))
    assert "did you mean 'name' or 'settings.name'?" in str(UnknownNameError("key", "nam", valid))
    assert "did you mean 'settings.eps'" in str(UnknownNameError("key", "setings.eps", valid))


def test_of_a_long_list_that_a_command_prints_the_nearest_three_stand():
    names = [f"name_{i}" for i in range(500)]
    text = str(UnknownNameError("metric", "name_7x", names, "moc-opt metrics"))
    assert "did you mean 'name_7'" in text
    assert text.count("name_") == 4  # what was written, and three
    assert text.endswith("`moc-opt metrics` lists all 500")
    names += ["osqp", "proxqp", "nlp-fatrop"]
    assert "did you mean 'proxqp'? `" in str(UnknownNameError("solver", "proxpq", names, "moc-opt solvers --list"))
    assert str(UnknownNameError("metric", "a", names[:3], "moc-opt metrics")).endswith("name_0, name_1, name_2")
