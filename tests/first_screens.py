"""What every report has to begin with, read off its HTML."""

import re

FOLDS = '<details class="section"'


def check(html: str, pictures: int = 3) -> None:
    """One to three sentences, one table of at most eight columns, pictures, links that lead into the folds."""
    first, rest = html[: html.index(FOLDS)], html[html.index(FOLDS) :]
    assert 1 <= first.count('<p class="headline">') <= 3
    assert first.count("<table ") == 1
    assert 1 < first.count('<th scope="col"') <= 8
    assert first.count('class="chart"') == pictures
    assert all(re.findall(r"<b>Figure \d+\.</b> (.*?)</figcaption>", first))
    links = set(re.findall(r'<a href="#([^"]+)"', first))
    assert links
    assert links <= set(re.findall(r'<details class="section" id="([^"]+)"', rest))
