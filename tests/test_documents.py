"""README's fenced blocks run from top to bottom in an empty folder."""

import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

import moc_opt as mo

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CHECKOUT = "make "  # blocks that begin with this word need a checkout, and do not run here
PATIENCE_S = 1200  # time limit for one block


def blocks(document):
    """Return (language, text) of every fenced block."""
    return BLOCK.findall((ROOT / document).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return an empty folder and an environment with this checkout's `moc-opt`."""
    folder, tools = tmp_path_factory.mktemp("empty"), tmp_path_factory.mktemp("bin")
    command = tools / "moc-opt"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m moc_opt "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    paths = {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    return folder, {**os.environ, **paths, "COLUMNS": "120"}


def run(command, place):
    folder, environment = place
    found = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert found.returncode == 0, f"{command}\n{found.stdout[-2000:]}\n{found.stderr[-2000:]}"


def serve(line, place):
    """Start a server, wait for its address, and press Ctrl-C."""
    folder, environment = place
    words = line.partition("#")[0].split()
    with subprocess.Popen(
        [*words, "--port", "0"], cwd=folder, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        said = next((text for text in process.stdout if "http://127.0.0.1" in text), "")
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        assert process.wait(60) in (0, 130)
        assert said


def test_code_blocks_of_readme_and_start_page_run(place):
    found = blocks("README.md")
    assert [language for language, _ in found] == ["sh", "sh", "python", "python"]
    for text in (text for language, text in found if language == "sh" and not text.startswith(CHECKOUT)):
        lines = text.splitlines()
        served = [line for line in lines if line.startswith("moc-opt live")]
        run(["bash", "-euc", "\n".join(line for line in lines if line not in served)], place)
        for line in served:
            serve(line, place)
    folder, _ = place
    pages = {"report.html", "both.html", "replay.html", "map.html"}
    written = {"scenario.toml", "clarabel.parquet", "network.parquet", "c", *pages}
    assert {file.name for file in folder.iterdir()} == written
    # The published network does not raise mu.
    mu = {name: mo.load_trace(folder / f"{name}.parquet").mu for name in ("clarabel", "network")}
    assert mu["clarabel"].mean() > 1.2 * mu["network"].mean()
    tour = [text for language, text in blocks("docs/start.md") if language == "python" and "elbow.html" in text]
    python = [text for language, text in found if language == "python"]
    run([sys.executable, "-P", "-c", "\n".join([*python, *tour])], place)
    assert (folder / "elbow.html").stat().st_size > 10_000


def test_start_page_shows_scenario_and_commands_of_readme():
    (scenario,) = (text for kind, text in blocks("docs/start.md") if kind == "toml")
    script = next(text for kind, text in blocks("README.md") if "scenario.toml" in text)
    assert script.startswith(f"cat > scenario.toml <<'END'\n{scenario}END\n")
    said = {line.partition("  #")[0] for line in script.splitlines()}
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    commands = re.findall(r"^    (moc-opt .*?)(?:  # .*)?$", page, re.MULTILINE)
    assert len(commands) >= 4
    assert [line for line in commands if not any(one.startswith(line.rstrip()) for one in said)] == []


def test_make_targets_that_readme_names_exist():
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    lines = [line for _, text in blocks("README.md") if text.startswith(CHECKOUT) for line in text.splitlines()]
    assert len(lines) >= 2
    assert {line.split()[0] for line in lines} == {"make"}
    assert {line.split()[1] for line in lines} <= set(targets)


def test_every_linked_file_exists():
    for document in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = document.read_text(encoding="utf-8")
        links = re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", text)
        assert [link for link in links if not (document.parent / link).exists()] == [], document.name
        named = re.findall(r"`((?:moc_opt|benchmarks|tests|examples|docs)/[\w./-]+\.\w+)`", text)
        assert [path for path in named if "NAME" not in path and not (ROOT / path).exists()] == [], document.name


def test_all_files_agree_on_the_version():
    said = {name: (ROOT / name).read_text("utf-8") for name in ("CITATION.cff", "CHANGELOG.md", "README.md")}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = dict(re.findall(r"^(version|date-released): (.*)$", said["CITATION.cff"], re.MULTILINE))
    headings = re.findall(r"^## (.*)$", said["CHANGELOG.md"], re.MULTILINE)
    assert project["version"] == cited["version"] == mo.__version__
    assert headings[:2] == ["[Unreleased]", f"[{mo.__version__}] - {cited['date-released']}"]
    pythons = re.findall(r"Python :: (3\.\d+)$", "\n".join(project["classifiers"]), re.MULTILINE)
    (badge,) = re.findall(r"^!\[Python (.*?)\]", said["README.md"], re.MULTILINE)
    assert badge.split(", ") == pythons
    assert project["requires-python"] == f">={pythons[0]}"
