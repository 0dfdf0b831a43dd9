"""What the two ends of the wire print of a run."""

from __future__ import annotations

from moc_opt.commands.wire import _ending_table


def test_what_is_zero_is_left_out_and_refused_answers_are_told_in_words() -> None:
    lied = {"count": 48, "first_at_s": 7.25, "first": "not optimal"}
    given = {"ended": "completed", "faults": {"lied": lied}, "missed": 0, "system": {"load": 1.5}}
    table = _ending_table("mine", given)
    told = [(row["what"], row["value"]) for row in table.rows]
    assert told == [
        ("ended", "completed"), ("faults: lied", "48, first at 7.250 s: not optimal"), ("system: load", "1.5"),
    ]  # fmt: skip
