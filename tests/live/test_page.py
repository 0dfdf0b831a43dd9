"""The live page is titled by what it shows."""

import pytest

from moc_opt.__main__ import main

viser = pytest.importorskip("viser", reason="the live page needs viser: pip install 'moc-opt[live]'")


@pytest.mark.parametrize(
    ("text", "title"),
    [('[task]\npath = "spiral"\n', "biopsy"), ('name = "second try"\n', "second try"), (None, "circle")],
)
def test_the_page_is_titled_by_the_scenario_s_name_or_file(tmp_path, monkeypatch, text, title):
    from moc_opt.live import page

    labels = []

    class Stop(Exception):
        """Raised in the place of a server."""

    def server(*args, label, **kwargs):
        labels.append(label)
        raise Stop

    monkeypatch.setattr(page, "_viser", lambda: server)
    file = tmp_path / "biopsy.toml"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(Stop):
        main(["live", *([str(file)] if text is not None else [])])
    assert labels == [f"moc_opt: {title}"]
