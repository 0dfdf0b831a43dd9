"""The page of a study."""

from moc_opt.figures.style import figure
from moc_opt.report.tables import Column, Table
from moc_opt.study import show
from moc_opt.study.show import Picture, Report, Section

TABLE = Table(
    "First", [Column("arm", "arm", section="All figures"), Column("mu", "mean", unit="m^3", format=".2f")],
    [{"arm": "a|b", "mu": 0.126}, {"arm": "c"}], "Over ten trials.",
)  # fmt: skip
INNER = Table("Second", [Column("arm", "arm")], [{"arm": "panda"}])
REPORT = Report(
    "A title", ["It holds.", "It is `exact`."], TABLE, [Picture(figure(), "See the point.", "seen")],
    [Section("All figures", "Read these.", [INNER, Picture(figure(), "More.", "more")])], load="Times were taken.",
)  # fmt: skip


def test_page_begins_with_the_result() -> None:
    failed = [{"trial": "t1", "controller": "rnn", "error": "hung: 30 s", "unknown": 1}]
    html = REPORT.page({"seed": 3}, failed).html()
    order = ["It holds.", "It is <code>exact</code>", "First", "Times were taken.", 'id="seen"', "Read these.",
             "Second", 'id="more"', "Runs that failed", "hung: 30 s", "Environment"]  # fmt: skip
    text = html[html.index("<body") :]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert "Runs that failed" not in REPORT.page({}).html()


def test_picture_shows_each_interval() -> None:
    given = {"one": (1.0, 2.0, 4.0), "two": (3.0, 3.0, 3.0)}
    drawn = show.intervals_picture(given, "x [us]", {"limit": 10.0}, {"one": "#000000"}, log=True)
    found = {}
    for line in drawn.data:
        (value,) = line.x
        found[line.y[0]] = (value - line.error_x.arrayminus[0], value, value + line.error_x.array[0])
    assert found == given
    assert [*found] == ["two", "one"], "the first name is drawn last, at the top"
    summary = {"a": 2.0, "a_low": 1.0, "a_high": 4.0, "b": 3.0, "b_low": float("nan"), "b_high": float("nan")}
    assert [show.ends(summary, name) for name in "abc"] == [given["one"], given["two"], None]
