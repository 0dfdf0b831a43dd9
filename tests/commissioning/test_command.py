"""The commands `robot new` and `robot check` as a user types them."""

from __future__ import annotations

from pathlib import Path

import pytest

from moc_opt.__main__ import main
from tests.commissioning.arms import text_of, with_hand


def test_check_prints_a_table_and_a_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "iiwa14"]) == 0
    said = capsys.readouterr().out
    assert "1 real, 1 idle (joint_7)" in said
    assert "verdict: iiwa14 can be used" in said
    assert max(len(line.rstrip()) for line in said.splitlines()) <= 80


def test_new_then_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "vendor.urdf", tmp_path / "my.toml"
    source.write_text(with_hand(text_of("iiwa14")), encoding="utf-8")
    assert main(["robot", "new", str(source), "--tool", "0.25", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "2 fingers branch off" in said
    assert "tool 250 mm" in said
    assert "length_m = 0.25" in out.read_text(encoding="utf-8")
    assert main(["robot", "check", str(out)]) == 0
    assert main(["robot", "new", str(source), "--out", str(out)]) == 2
    assert "exists" in capsys.readouterr().err


def test_a_verdict_of_cannot_is_an_exit_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "vendor.urdf", tmp_path / "my.toml"
    source.write_text(text_of("iiwa14"), encoding="utf-8")
    assert main(["robot", "new", str(source), "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith("q_rad"))
    out.write_text(text.replace(line, f"q_rad = {[0.0] * 7}"), encoding="utf-8")
    capsys.readouterr()
    assert main(["robot", "check", str(out)]) == 3
    assert "cannot be used" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--lock", "joint_3=x"], "write JOINT or JOINT=VALUE"),
        (["--lock", "joint_3"], "of 6 joints"),
        (["--tip", "gone"], "unknown link"),
        (["--tool", "-1"], "tool"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "vendor.urdf"
    source.write_text(text_of("iiwa14"), encoding="utf-8")
    assert main(["robot", "new", str(source), *arguments, "--out", str(tmp_path / "my.toml")]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "my.toml").exists()


def test_from_a_vendors_file_to_a_replay_in_three_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "vendor.urdf").write_text(with_hand(text_of("xarm7")), encoding="utf-8")
    (tmp_path / "short.toml").write_text("duration_s = 0.1\nbound_samples = 2\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["robot", "new", "vendor.urdf", "--out", "my.toml"]) == 0
    assert main(["run", "short.toml", "--robot", "my.toml", "--trace", "run.parquet"]) == 0
    (tmp_path / "my.toml").unlink()  # the trace carries the arm
    assert main(["replay", "run.parquet", "--out", "run.html"]) == 0
    assert (tmp_path / "run.html").stat().st_size > 20_000
    assert main(["run", "short.toml", "--robot", "my.toml"]) == 2
    assert "my.toml" in capsys.readouterr().err
