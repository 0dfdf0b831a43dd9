"""Messages stay short, whatever a file holds."""

import pytest

from moc_opt.errors import MocOptError, RobotError, TraceError, UnknownNameError
from moc_opt.model.robot_model import load_robot


@pytest.mark.parametrize("kind", [MocOptError, RobotError, TraceError])
def test_a_text_of_a_megabyte_is_cut(kind):
    assert str(kind("a field, its value and the cure")) == "a field, its value and the cure"
    assert str(kind("x" * 2000)) == "x" * 2000
    cut = str(kind("begins so " + "x" * 10**6))
    assert len(cut) == 2000
    assert cut.startswith("begins so xxx")
    assert cut.endswith("...")


def test_a_list_of_valid_names_is_whole():
    names = [f"name_{i}" for i in range(500)]
    assert str(UnknownNameError("metric", "nome_7", names)).endswith("name_99")


def test_a_robot_file_of_thousands_of_unknown_tables_is_refused_in_a_few_lines(tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text("".join(f"[table_{i}]\n" for i in range(3000)), encoding="utf-8")
    with pytest.raises(RobotError, match="table_0") as found:
        load_robot(file)
    assert len(str(found.value)) <= 2000
