"""docs/errata.md says what benchmarks.errata computes, and the numbers in it show what they are there to show."""

import numpy as np
import pytest

from benchmarks.maintenance import errata, errata_numbers
from moc_opt.vision.board import BOARD_TASKS


@pytest.fixture(scope="module")
def arm():
    return errata_numbers.Arm.load()


def test_the_page_agrees_with_the_numbers(capsys):
    assert errata.main(["--check"]) == 0, capsys.readouterr().err


def test_a_page_that_does_not_agree_is_found_and_mended(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(errata, "page", lambda: "the numbers\n")
    file = tmp_path / "errata.md"
    assert errata.main(["--check", "--out", str(file)]) == 1
    assert "python -m benchmarks.errata" in capsys.readouterr().err
    assert errata.main(["--out", str(file)]) == 0
    assert errata.main(["--check", "--out", str(file)]) == 0
    file.write_text("other numbers\n")
    assert errata.main(["--check", "--out", str(file)]) == 1


def test_every_row_has_a_number(arm):
    text = errata.page(errata_numbers.Arm(arm.robot, arm.states[:8]))
    rows = [line for line in text.splitlines() if line.startswith("| ") and "printed |" not in line]
    assert len(rows) == len(errata.ERRATA)
    for row in rows:
        cells = [cell.strip() for cell in row.strip("|").split(" | ")]
        assert len(cells) == 4
        assert any(c.isdigit() for c in cells[3])


def test_only_the_printed_projector_moves_the_tip(arm):
    for state in arm.states:
        printed, dynamic, static = errata_numbers.projectors(state)
        assert errata_numbers.idempotence(printed) > 0.05
        assert max(errata_numbers.idempotence(dynamic), errata_numbers.idempotence(static)) < 1e-12
        leak = [np.abs(state.J_tip @ np.linalg.solve(state.M, N)).max() for N in (printed, dynamic)]
        assert leak[1] < 1e-10 < 0.1 < leak[0]


def test_printed_third_level_is_no_projection(arm):
    for state in arm.states:
        consistent, printed, _ = errata_numbers.third_level(state)
        assert errata_numbers.idempotence(consistent) < 1e-12
        assert errata_numbers.idempotence(printed) > 0.5


def test_printed_modes_are_slow_and_its_torque_is_small(arm):
    assert errata_numbers.time_constants(arm)[0] > 50.0
    assert 0.0 < errata_numbers.torque_of_mu(arm) < 2e-3


def test_the_true_lambda_is_where_the_geometry_puts_it(arm):
    """|P_t - X|/L for a shaft that nearly meets the trocar."""
    found = np.array(errata_numbers.true_lambdas(arm)).reshape(len(arm.states), -1)
    wanted = [task.depth_m / arm.states[0].tool_span for task in BOARD_TASKS.values()]
    np.testing.assert_allclose(found, np.tile(wanted, (len(found), 1)), rtol=1e-3)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "below 1e-12"),
        (3e-14, "below 1e-12"),
        (123.4, "120"),
        (0.0567, "0.057"),
        (3.71e7, "3.7e7"),
        (-2.0, "-2"),
        (1.2e-6, "1.2e-6"),
    ],
)
def test_numbers_are_written_alike_on_every_machine(value, text):
    assert errata.number(value) == text


def test_spans():
    assert errata.span([1.0, 2.0, 3.0]) == "1 to 3"
    assert errata.span([1.001, 1.002]) == "1"
