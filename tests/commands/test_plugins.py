"""Waypoints from a file, and plug-ins from other packages."""

import json
import sys

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.commands.running import read_waypoints
from moc_opt.errors import ScenarioError
from moc_opt.trace import metrics

PACKAGE = '''
import os, numpy as np
from moc_opt.trace.metrics import metric

def helix(radius, pitch=0.01):
    """Go round once while climbing."""
    w = np.linspace(0.0, 2 * np.pi, 17)
    return np.stack([radius * np.sin(w), radius * (1 - np.cos(w)), pitch * w / (2 * np.pi)], axis=1)

@metric("rad")
def own_travel_rad(trace):
    """Sum of all joint motion."""
    print(os.system("echo with --json, this text goes to stderr, although another process prints it"))
    return float(abs(trace.q_rad[1:] - trace.q_rad[:-1]).sum())
'''
POINTS = [[0.01, 0.0, 0.0], [0.02, 0.01, -0.005], [0.03, 0.0, 0.0]]


def printed(capfd, *arguments):
    status, found = main(["run", *map(str, arguments), "--json"]), capfd.readouterr()
    assert status == 0, found.err
    return json.loads(found.out)


def test_plugin_of_another_package_can_be_used_by_name(tmp_path, monkeypatch, capfd):
    info = tmp_path / "own_things-1.0.dist-info"
    info.mkdir()
    (tmp_path / "own_things.py").write_text(PACKAGE, encoding="utf-8")
    (info / "entry_points.txt").write_text(
        "[moc_opt.tasks]\nhelix = own_things:helix\n[moc_opt.metrics]\nown_travel_rad = own_things:own_travel_rad\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(metrics, "_LOADED", {})
    monkeypatch.delitem(sys.modules, "own_things", raising=False)
    file, short, trace = tmp_path / "own.toml", tmp_path / "short.toml", tmp_path / "own.parquet"
    file.write_text(
        'bound_samples = 0\njudge = false\nbest_courses = false\nmetrics = ["own_travel_rad", "mu_mean"]\n'
        '[task]\npath = "helix"\nwait_s = 0.0\nhold_s = 0.0\n[task.sizes]\nradius = 0.004\n'
    )
    found = printed(capfd, file, "--trace", trace)
    assert {"own_travel_rad", "mu_mean"} <= set(found) <= {"own_travel_rad", "mu_mean", "ended", "warnings", "faults"}
    assert found["own_travel_rad"] > 0.0
    ends = mo.load_trace(trace).tip_ref_m[[0, -1]]
    np.testing.assert_allclose(ends[1] - ends[0], [0.0, 0.0, 0.01], atol=1e-4)
    short.write_text("duration_s = 0.02\nbound_samples = 0\n[task.sizes]\nradius = 0.01\n")
    assert "own_travel_rad" in printed(capfd, short, "--metric", "own_travel_rad")
    for arguments, said in (
        (["run", str(short), "--task", "helix"], "[task] a helix needs its radius"),
        (["run", str(short), "--metric", "own_travel"], "did you mean 'own_travel_rad'"),
    ):
        assert main(arguments) == 2
        assert said in capfd.readouterr().err
    for listed in (["tasks"], ["metrics"]):
        assert main([*listed, "--json"]) == 0
        assert {"helix", "own_travel_rad"} & set(json.loads(capfd.readouterr().out))


def test_waypoints_can_be_read_from_a_file(tmp_path, capsys):
    points, file = tmp_path / "points.csv", tmp_path / "short.toml"
    points.write_text("# of a probe\nx_m,y_m,z_m\n0.01, 0, 0\n0.02 0.01 -0.005\n\n0.03,0,0\n", encoding="utf-8")
    file.write_text("duration_s = 0.7\nbound_samples = 0\nbest_courses = false\n[task]\nwait_s = 0.0\n")
    printed(capsys, file, "--task", points, "--trace", tmp_path / "a.parquet")
    scenario = mo.Scenario(duration_s=0.7, bound_samples=0, task={"waypoints_m": POINTS, "wait_s": 0.0})
    assert scenario.task.path == "waypoints"
    asked = mo.run(scenario).tip_ref_m
    np.testing.assert_array_equal(mo.load_trace(tmp_path / "a.parquet").tip_ref_m, asked)
    assert np.ptp(asked, axis=0).min() > 1e-4


@pytest.mark.parametrize(("text", "line", "cure"), [
    ("x_mm,y_mm,z_mm\n10,0,0\n", 1, r"the first line may name the columns \(x_m,y_m,z_m\)"),
    ("# index and all\n0,0.1,0,0\n1,0.2,0,0\n", 2, "give x, y, z"), ("0 0 0\n1 2 nan\n", 2, "nan"),
    ("0,0,\u0661\n", 1, "give x, y, z"),
])  # fmt: skip
def test_wrong_file_of_points_is_refused(text, line, cure, tmp_path):
    file = tmp_path / "points.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=rf"line {line}: .*{cure}"):
        read_waypoints(str(file))


@pytest.mark.parametrize(("arguments", "cure"), [
    (["--task", "bad.csv"], "bad.csv': the file contains no point"), (["--task", "spirla"], "did you mean 'spiral'"),
    (["dcac.toml", "--solver", "osqp"], "law = 'dcac' has no solver"),
])  # fmt: skip
def test_wrong_option_of_run_is_refused_with_a_remedy(arguments, cure, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("# nothing\n", encoding="utf-8")
    (tmp_path / "dcac.toml").write_text("control.law = 'dcac'\n", encoding="utf-8")
    assert main(["run", *arguments]) == 2
    assert cure in capsys.readouterr().err
    for task, said in ({"path": "spiral", "waypoints_m": POINTS}, "remove"), ({"path": "waypoints"}, "give"):
        with pytest.raises(ScenarioError, match=said):
            mo.Scenario(task=task)
