"""The replay agrees with the model and the trace."""

import base64
import gzip
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moc_opt.errors import MocOptError
from moc_opt.report.replay import BASE, FRAMES_PER_S, Replay, arm_parts, load_runs, velocity_ellipsoids
from moc_opt.robots.model import RobotModel, link_frames
from moc_opt.trace.trace import Trace
from tests.conftest import opened


def wave(robot: RobotModel, ticks: int, *, phase: float = 0.0) -> Trace:
    """Return a trace at 500 Hz of an arm that sways."""
    t = 0.002 * np.arange(ticks)
    q = robot.data.q_home + 0.2 * np.sin(2.0 * t[:, None] + phase + np.arange(robot.n))
    tips, rng = robot.tool_along(q)[0], np.random.default_rng(ticks)
    columns = {
        "t_s": t, "q_rad": q, "tip_m": tips, "tip_ref_m": tips + 1e-4, "mu": 0.3 + 0.01 * np.sin(t + phase),
        "trocar_m": np.tile(tips[0] + [0.0, 0.0, 0.15], (ticks, 1)), "tip_error_m": 1e-4 * rng.random(ticks),
        "rcm_error_m": 1e-3 * rng.random(ticks), "trocar_force_N": rng.normal(size=(ticks, 3)),
    }  # fmt: skip
    return Trace(columns, {"ended": "completed", "robot": "lwr4"})


@pytest.mark.parametrize("arm", ["robot", "odd_robot"])
def test_frames_agree_with_the_model(arm: str, request: pytest.FixtureRequest) -> None:
    model: RobotModel = request.getfixturevalue(arm)
    q = np.random.default_rng(1).uniform(model.q_min, model.q_max, (5, model.n))
    origins, rotations = link_frames(model, q)
    parts = arm_parts(model)
    (tool,) = (part for part in parts if part.role == "tool")
    end = tool.origin + tool.heights[-1] * tool.axis
    for k, pose in enumerate(q):
        state = model.state(pose)
        for point, where in ((end, state.tip), (model.chain.offsets[1], state.wrist)):
            np.testing.assert_allclose(origins[k, -1] + rotations[k, -1] @ point, where, atol=1e-12)
    assert {part.role for part in parts} == {"shell", "joint", "tool"}
    assert {part.link for part in parts} == set(range(BASE, model.n))
    assert all((part.radii >= 0.0).all() and abs(np.linalg.norm(part.axis) - 1.0) < 1e-9 for part in parts)


def test_half_axes_of_each_ellipsoid_multiply_to_mu(robot: RobotModel, regular_poses: Any) -> None:
    states = [robot.state(q) for q in regular_poses(5)]
    jacobians = np.array([state.J_tip for state in states])
    roots = velocity_ellipsoids(jacobians)
    np.testing.assert_allclose(roots @ roots, jacobians @ np.swapaxes(jacobians, 1, 2), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(roots), [state.mu for state in states], rtol=1e-9)


def test_replay_shows_the_values_of_its_traces(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = {"long": wave(robot, 1500), "short": wave(robot, 700, phase=1.0)}
    replay = Replay(runs, robot)
    data = replay.data()
    times = data["times"]
    assert (times[0], times[-1]) == (0.0, pytest.approx(runs["long"].t_s[-1]))
    assert 0.9 / FRAMES_PER_S < np.diff(times).min() <= np.diff(times).max() < 1.05 / FRAMES_PER_S
    for run, trace in zip(data["runs"], runs.values(), strict=True):
        for k in (0, 7, len(times) - 1):
            tick = min(int(np.floor(times[k] / 0.002 + 1e-6)), len(trace) - 1)
            origins, _ = link_frames(robot, trace.q_rad[[tick]])
            np.testing.assert_allclose(run["poses"][k, :, :, 3], origins[0], atol=2e-3)
            np.testing.assert_allclose(run["tip"][k], trace.tip_m[tick], atol=1e-3)
            assert run["panels"][0]["at"][k] == pytest.approx(trace.mu[tick], abs=1e-4)
        force = np.linalg.norm(trace.trocar_force_N, axis=1)
        assert run["panels"][3]["y"].max() == pytest.approx(force.max(), rel=1e-6)
    short = data["runs"][1]
    assert short["end"] == pytest.approx(runs["short"].t_s[-1])
    np.testing.assert_array_equal(short["poses"][-1], short["poses"][-2])
    monkeypatch.setattr("moc_opt.report.replay.FRAMES_IN_ALL", 100)
    assert len(Replay(runs, robot).data()["times"]) == 50, "two runs share FRAMES_IN_ALL frames"
    monkeypatch.undo()
    packed = re.search(r'id="replay-data">([^<]+)<', replay.html())
    written = json.loads(gzip.decompress(base64.b64decode(packed[1])))
    np.testing.assert_allclose(written["runs"][1]["poses"], short["poses"].ravel(), atol=1e-6)
    assert [run["name"] for run in written["runs"]] == ["long", "short"]


def test_unusable_traces_are_refused(robot: RobotModel, tmp_path: Path) -> None:
    good = wave(robot, 100)
    for traces, words in (
        ({}, "1 to 4"), ({str(k): good for k in range(5)}, "1 to 4"),
        ({"x": Trace({"t_s": good.t_s, "q_rad": good.q_rad})}, "'x' lacks the columns tip_m"),
    ):  # fmt: skip
        with pytest.raises(MocOptError, match=re.escape(words)):
            Replay(traces, robot)
    (tmp_path / "again").mkdir()
    files = [tmp_path / "exact.parquet", tmp_path / "dcac.parquet", tmp_path / "again" / "exact.parquet"]
    for file in files:
        good.save(file)
    assert list(load_runs(files)[0]) == ["exact", "dcac", str(files[2])]
    other = tmp_path / "other.parquet"
    Trace(good.columns, {"scenario": {"robot": {"name": "lwr4", "tool_length_m": 0.4}}}).save(other)
    for wrong in ([files[0], other], []):
        with pytest.raises(MocOptError, match="one robot with one tool"):
            load_runs(wrong)


def arm_of(page: Any) -> bytes:
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return page.locator("#scene").screenshot()


@pytest.fixture(scope="module")
def page(chromium: Any, robot: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    runs = {"swaying": wave(robot, 1500), "swaying otherwise": wave(robot, 1500, phase=1.5)}
    file = Replay(runs, robot).save(tmp_path_factory.mktemp("replay") / "replay.html")
    size = {"viewport": {"width": 900, "height": 800}, "device_scale_factor": 0.25}  # few pixels are enough
    with opened(chromium, file.as_uri(), "html[data-drawn=yes]", **size) as found:
        yield found


def test_slider_moves_the_arm(page: Any) -> None:
    page.evaluate("replay.seek(0)")
    arm, curve = arm_of(page), page.locator(".plot canvas").first.screenshot()
    box = page.locator("#time").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert page.evaluate("replay.time") == pytest.approx(1.5, abs=0.1)
    assert arm_of(page) != arm
    assert page.locator(".plot canvas").first.screenshot() != curve
    assert page.locator("#clock").inner_text().startswith("1.5")
    page.evaluate("replay.seek(0)")
    assert arm_of(page) == arm, "nothing moves by itself"


def test_replay_is_controlled_by_keys(page: Any) -> None:
    page.evaluate("replay.seek(0)")
    page.locator("h1").click()
    page.keyboard.press("Space")
    page.wait_for_function("replay.time > 0.1")
    page.keyboard.press("Space")
    assert not page.evaluate("replay.playing")
    for keys, time in ((("Home", "Shift+ArrowRight", "ArrowRight"), 1.1), (("End",), 2.998)):
        for key in keys:
            page.keyboard.press(key)
        assert page.evaluate("replay.time") == pytest.approx(time)
    page.locator("#play").click()
    assert page.evaluate("replay.time") < 2.9, "at its end, the play button starts the replay from t = 0"
    page.locator("#play").click()
