"""The exported folder with C code."""

import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.errors import ScenarioError
from moc_opt.export import export_scenario, folder
from moc_opt.export.scenario import TICKS
from moc_opt.scenario import Scenario
from tests.export.conftest import FLAGS, make

RUNS = {
    "default": {}, "paper": {"control": {"preset": "paper"}}, "dcac": {"control": {"law": "dcac"}},
    "dcac-damped": {"control": {"law": "dcac", "dcac_damping": 2.0, "limit_torque": False},
                    "guard": {"trocar_force_N": None, "patience_ticks": 1}},
    "scaled": {"control": {"climb": "scaled", "projector": "static", "fallback": "hold",
                           "supervisor": {"hold_ticks": 2}}},
    "damping": {"control": {"fallback": "damping", "regularization": 0.0, "rcm_lambda": 0.5}},
    "panda": {"robot": {"name": "panda"}}, "lwr4_rail": {"robot": {"name": "lwr4_rail"}},
    "noise": {"plant": {"preset": "realistic"}, "start": {"pose": "random"}, "seed": 5},
}  # fmt: skip


@pytest.fixture(scope="module")
def default(exported):
    return exported(Scenario(duration_s=1.0))


@pytest.mark.parametrize("name", RUNS)
def test_exported_code_computes_exactly_the_torque_of_python(name, exported):
    done = make(exported(Scenario(**{"duration_s": 1.0, **RUNS[name]})), "test", FLAGS)
    assert done.returncode == 0, done.stdout + done.stderr
    right = r"(\d+) ticks, (\d+) limited, .* \(tick (\d+), as expected.*\); largest difference .* (\S+) Nm"
    *counts, difference = re.search(right, done.stdout).groups()
    ticks, limited, stopped_at = map(int, counts)
    assert (ticks, difference) == (TICKS, "0.0e+00")
    assert 2 * TICKS // 3 + 30 < stopped_at < ticks
    assert limited > 0 or name in ("panda", "dcac-damped")  # these two stop before any torque is limited
    assert re.search(r"one tick: mean [\d.]+ us, longest [\d.]+ us", done.stdout)


@pytest.mark.parametrize(("file", "old", "new"), [
    ("safety_filter.c", "w->bad += w->bad < INT_MAX;", ""),
    ("constants.c", ".torque_step = ", ".torque_step = 0.01 * "),
    ("safety_filter.c", "return newer ? FRESH : REPEAT;", "return FRESH;"),
    ("answer.c", "        least_violation(p, x);", "        ;"),
])  # fmt: skip
def test_self_test_fails_for_wrong_code(default, tmp_path, file, old, new):
    wrong = Path(shutil.copytree(default, tmp_path / "wrong"))
    text = (wrong / file).read_text()
    assert old in text
    (wrong / file).write_text(text.replace(old, new))
    done = make(wrong, "test", f"{FLAGS} -Wno-error")
    assert done.returncode != 0, done.stdout
    assert "largest difference" in done.stdout, done.stderr


def test_numbers_are_written_exactly():
    assert folder.in_c([0.1, -math.inf, math.inf, math.nan, True, 3, np.float64(1e-300)]) == (
        "{0.1, -INFINITY, INFINITY, NAN, 1, 3, 1e-300}"
    )


@pytest.mark.parametrize(("tables", "words"), [
    ({"solver": {"name": "rnn"}}, r"\[solver\] name = 'rnn'.*use 'exact'"),
    ({"solver": {"replay_us": [10.0]}}, r"\[solver\] replay_us = \(10.0,\).*remove this key"),
    ({"solver": {"isolation": "process"}}, r"\[solver\] isolation = 'process'.*remove this key"),
    ({"control": {"third_level": "receding"}}, r"\[control\] third_level = 'receding'.*use 'local'"),
    ({"control": {"supervisor": {"budget_us": 100.0}}}, r"budget_us = 100.0.*remove this key"),
])  # fmt: skip
def test_error_names_the_unsupported_setting(tmp_path, tables, words):
    with pytest.raises(ScenarioError, match=words):
        export_scenario(Scenario(**tables), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_export_overwrites_only_its_own_files(tmp_path, capsys):
    scenario, out = tmp_path / "scenario.toml", tmp_path / "c"
    scenario.write_text("duration_s = 0.5\n")
    command = ["export-c", str(scenario), "--out", str(out)]
    for _ in range(2):
        assert main([*command, "--main", "udp"]) == 0
        said = capsys.readouterr().out
        assert all(str(path) in said for path in out.iterdir())
    for file in {*out.iterdir()} - {out / "reference.bin"}:
        assert "SPDX-License-Identifier: Apache-2.0" in file.read_text().partition("\n")[0]
    (out / "robot.c").write_text("int mine;\n")
    (out / "main.c").write_text((out / "main.c").read_text().replace("ROUNDS = 500", "ROUNDS = 5"))
    changed = (out / "main.c").read_text()
    assert main(command) == 2
    assert "main.c in it is edited, or not from export-c: name another folder, or" in capsys.readouterr().err
    assert (out / "main.c").read_text() == changed
    assert main([*command, "--force"]) == 0
    assert (out / "main.c").read_text() != changed
    assert (out / "robot.c").read_text() == "int mine;\n"
