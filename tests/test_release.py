"""A release says one thing everywhere: version, date, and the versions of Python that it was tried with."""

import re
import tomllib
from pathlib import Path

import moc_opt

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_package_project_citation_and_changelog_name_one_version_and_one_day():
    cited = dict(re.findall(r"^(version|date-released): (.*)$", text("CITATION.cff"), re.MULTILINE))
    headings = re.findall(r"^## (.*)$", text("CHANGELOG.md"), re.MULTILINE)
    assert PROJECT["version"] == cited["version"] == moc_opt.__version__
    assert headings[:2] == ["[Unreleased]", f"[{moc_opt.__version__}] - {cited['date-released']}"]


def test_the_pythons_of_the_metadata_are_those_of_the_badge():
    listed = [word.rpartition(" ")[2] for word in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", word)]
    (badge,) = re.findall(r"^!\[Python (.*?)\]", text("README.md"), re.MULTILINE)
    assert badge.split(", ") == listed
    assert PROJECT["requires-python"] == f">={listed[0]}"
