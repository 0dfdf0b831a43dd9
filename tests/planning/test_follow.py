"""A follower turns a course into desired velocities, which the arm follows."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import moc_opt as mo
from moc_opt.errors import MocOptError, ScenarioError, TaskError
from moc_opt.planning import guides
from moc_opt.planning.course import Course
from moc_opt.planning.follow import ASKED_EACH, NODES, Follower, Piece
from moc_opt.planning.guides import FASTEST, HURRY, SPEEDS, Ways, followed_course, load_course, speed_shares
from moc_opt.planning.pose_map import largest_mu, reach
from moc_opt.planning.program import Program
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.planned import followable_plan, plan, save_course, targets_of
from moc_opt.tasks.trocar import shaft_distance

BARE = Scenario(bound_samples=0, judge=False)
FOLLOWED = BARE.change(control={"third_level": "planned"}, plant={"preset": "nominal"})
# From this start, the local law ends at a local maximum, far below the largest mu.
TRAPPED = BARE.change(
    seed=9, duration_s=4.0, control={"third_level": "receding"}, start={"pose": "random"}, task={"path": "circle"}
)


@cache
def setup(level="receding"):
    return Setup((FOLLOWED if level == "planned" else TRAPPED).change(control={"third_level": level}))


@cache
def ran(level):
    return setup(level).trace() if level == "receding" else mo.run(TRAPPED.change(control={"third_level": level}))


def follower(of):
    guide = of.controller()._guide
    guide.start()
    return guide


planned_ways = cache(lambda: Ways(setup("planned").following))


def test_the_desired_velocity_corrects_the_position_error(robot):
    t = np.linspace(0.0, 1.0, 11)
    guide = Follower(0.002, course=Course(t, robot.data.q_home + 0.1 * t[:, None], np.ones(11), 0.0))
    guide.start()
    for tick in range(400):
        desired = guide.desired_velocity(robot.state(robot.data.q_home + 0.1 * 0.002 * tick))
        np.testing.assert_allclose(desired, 0.1, atol=1e-9)
    guide.start()
    np.testing.assert_allclose(guide.desired_velocity(robot.state(robot.data.q_home + 0.01)), 0.1 - 0.05, atol=1e-9)
    for _ in range(600):  # after the end of the course, its final pose is held
        last = guide.desired_velocity(robot.state(robot.data.q_home + 0.2))
    np.testing.assert_allclose(last, 5.0 * (0.1 - 0.2), atol=1e-9)


def test_a_course_is_interpolated_by_cubic_polynomials():
    t, (q, v) = np.linspace(0.3, 1.5, 5), np.random.default_rng(0).normal(size=(2, 5, 7))
    piece, cubic = Piece(t, q, v), CubicHermiteSpline(t, q, v)
    for at in (0.3, 0.45, 0.9, 1.37, 1.4999):
        np.testing.assert_allclose(piece.at(at), [cubic(at), cubic(at, 1)], atol=1e-12)
    np.testing.assert_array_equal([piece.at(0.1), piece.at(1.5)], [[q[0], v[0]], [q[-1], np.zeros(7)]])


def test_an_arm_that_left_its_course_reaches_the_maximum_of_mu():
    made = Setup(TRAPPED.change(control={"third_level": "planned"}))
    robot, guide, q, held = made.robot, follower(made), np.array(made.q_start), 500
    targets = targets_of(robot, made.layout, made.ticks + 1)
    assert robot.mu_along(guide._given.at(1.0)[0][None])[0] > 1.3 * robot.mu_along(q[None])[0]
    for tick in range(made.ticks):
        desired = guide.desired_velocity(robot.state(q))
        if tick == 0:
            assert not guide.told
        q = q if tick < held else q + 0.002 * desired
        if tick % 25 == 0:
            q = reach(robot, q, targets.tip[tick + 1], targets.wrist[tick + 1])
    assert round(guide.told["left_course_s"] / 0.002) in range(0, 500, ASKED_EACH)
    assert robot.mu_along(q[None])[0] > 0.99 * robot.mu_along(guide._given.q_rad[-1:])[0]
    guide.start()
    assert not guide.told


def test_the_arm_follows_its_course_in_a_run():
    made = setup("planned")
    trace, guide = made.trace(), follower(made)
    assert (trace.meta["ended"], trace.meta["course_mu_mean"]) == ("completed", guide.course_mu_mean)
    assert guide.course_mu_mean == pytest.approx(made.robot.mu_along(guide._given.q_rad).mean(), rel=1e-2)
    wanted = np.array([guide._given.at(t)[0] for t in trace.t_s])
    assert np.abs(trace.q_rad - wanted)[trace.t_s > 1.0].max() < 0.05
    climbed = mo.run(FOLLOWED.change(control={"third_level": "local"}))
    # From this start, the local climb reaches the same maximum. The course gives up some mu to be smooth.
    assert trace.mu.mean() > 0.995 * climbed.mu.mean()
    assert Setup(FOLLOWED.change(control=FOLLOWED.control.matched_dcac())).controller()._guide is None


def test_a_start_just_inside_the_limit_margin_has_as_much_mu_as_a_start_deeper_inside():
    courses = []
    for swivel in (0.01, 0.0142):  # 0.030 and 0.043 rad from a limit
        made = Setup(FOLLOWED.change(start={"swivel": swivel}, control={"course_margin_rad": 0.05}))
        room = np.minimum(made.q_start - made.robot.q_min, made.robot.q_max - made.q_start)
        assert 0.02 < room[made.robot.moves.any(axis=0)].min() < 0.05
        courses.append(followed_course(made.following))
    deeper, just_inside = courses
    assert (just_inside.certified, just_inside.kept) == (True, True)
    assert just_inside.mu_mean > 0.99 * deeper.mu_mean


def test_a_faster_course_is_tried_if_it_raises_mu_enough(monkeypatch):
    q = (0.11625160465135753, -0.48236975363387774, 0.6927921516761183, -1.0529279629259627, 2.6042965767787516,
         1.9686742406249267, 1.3759513161472126)  # fmt: skip
    far = FOLLOWED.change(
        start={"q_rad": q, "check_path": False}, trocar={"depth_m": 0.2},
        task={"path": "spiral", "sizes": {"turns": 2.0, "radius": 0.015}},
    )  # fmt: skip
    here, there = planned_ways(), Ways(Setup(far).following)
    assert (here.speeds, there.speeds) == (SPEEDS, (HURRY, *SPEEDS))
    assert here.usual == pytest.approx(largest_mu(here.run.robot, here.at(1.0)[2].q_rad[::5]).mu.mean(), rel=2e-3)
    assert [there.at(part)[1].speed_share for part in there.speeds] == pytest.approx([0.952, 0.85, 0.595, 0.34])
    near_all = Ways(Setup(far.change(control={"course_speed_fraction": 0.95})).following)
    assert [near_all.at(part)[1].speed_share for part in (HURRY, 1.0)] == [FASTEST, 0.95]
    (value, limits, _), settings = there.at(1.0), there.run.settings
    assert (limits.shaft, limits.margin) == (0.25 * settings.shaft_margin, settings.course_margin_rad)
    assert value._price * value._period == pytest.approx(5e-4 / 0.3**2 * there.usual)
    for gain, first in ((1.005, ()), (1.02, (HURRY,))):
        monkeypatch.setattr(there, "at", lambda part, up=gain: [SimpleNamespace(of=lambda *_: 0.1 * up ** (part > 1))])
        assert there.speeds == (*first, *SPEEDS)


def test_slower_or_less_constrained_planners_are_tried_until_one_finds_a_course(monkeypatch):
    ways, tried = planned_ways(), []

    def program(*of, mu, smoothness, brake, horizon):
        assert (*of[1:3], mu, smoothness, horizon) == (NODES, 0.1, ways.usual, 5e-4, True)
        tried.append((of[3].speed_share / 1.03, brake / ways.run.brake, of[3].shaft / ways.shaft))

    planner = SimpleNamespace(plan=lambda *_: True if len(tried) == count else None)
    monkeypatch.setattr(guides, "Program", program)
    monkeypatch.setattr(guides, "Planner", lambda *_, horizon_s, rate_per_s: planner)
    steps = [(0.85, 1.0, 1.0), (0.595, 1.0, 1.0), (0.34, 1.0, 1.0), (0.34, np.inf, 1.0), (0.34, np.inf, 0.0)]
    for count in range(1, 7):
        tried.clear()
        with pytest.raises(TaskError, match="no course") if count == 6 else nullcontext():
            guides.replanned(ways)
        np.testing.assert_allclose(tried, steps[:count])


@pytest.mark.parametrize(("answers", "chosen"), [
    ([(1.0, False), (0.94, True), (0.96, True)], 2), ([(0.8, True), (0.9, True), (0.7, True), (0.6, True)], 1),
    ([(1.0, False), (1.0, False), (1.0, False), (0.5, True)], 3),
])  # fmt: skip
def test_slower_courses_are_tried_until_smoothing_costs_little_mu(monkeypatch, answers, chosen):
    """An answer is (mu after smoothing / mu before, whether all limits are kept). The last try has no brake limit."""
    run, tried, made = setup("planned").following, [], []

    def refined(robot, targets, course, limits, *, smoothness, brake):
        share, kept = answers[len(made)]
        tried.append((limits.speed_share, brake / run.brake))
        made.append(replace(course, mu=share * course.mu, violation=0.0 if kept else 1.0))
        return made[-1]

    monkeypatch.setattr(guides, "refine", refined)
    assert followed_course(run, planned_ways()) is made[chosen]
    np.testing.assert_allclose(tried, [(0.85, 0.9), (0.595, 0.9), (0.34, 0.9), (0.34, np.inf)][: len(answers)])


FAST = {"task": {"v_max_m_per_s": 2.0, "a_max_m_per_s2": 20.0}, "start": {"check_path": False}}


@pytest.mark.parametrize(("change", "message"), [
    ({"control": {"regularization": 0.0}}, "regularization = 0"), ({"control": {"c2": 0.0}}, "c2 = 0"),
    ({"control": {"law": "dcac"}}, r"law = 'dcac' with third_level = 'planned'"),
    (FAST, r"third_level = 'planned'.*mm along the path"),
    (FAST | {"control": {"third_level": "receding"}}, r"third_level = 'receding'.*mm along the path"),
])  # fmt: skip
def test_settings_with_which_no_course_can_be_followed_are_refused(change, message):
    with pytest.raises(MocOptError, match=message):
        Setup(FOLLOWED.change(**change)).controller()


def test_a_course_is_refused_if_it_is_too_fast_for_the_third_level(robot):
    shares = np.append(np.full(6, 0.85 + 5e-7), 1.0)
    assert guides.too_fast_to_follow(FOLLOWED.control, robot, shares) is None
    told, cure = guides.too_fast_to_follow(FOLLOWED.control, robot, shares + 1e-3 * np.eye(7)[2])
    assert (told[:41], cure) == ("joint_3 moves at 0.851 of its speed limit", "plan it with --speed-share 0.85")


def test_the_receding_horizon_leaves_a_local_maximum():
    trace, climbed, told = ran("receding"), ran("local"), ran("receding").meta["replans"]
    assert trace.meta["ended"] == "completed"
    assert 20.0 * (setup().duration_s - 0.3) < told["solves"] < 30.0 * setup().duration_s
    assert told["refused"] <= 0.05 * told["solves"]
    assert 0.0 < told["solve_ms_median"] <= told["solve_ms_p99"] < 1e4
    assert trace.mu.mean() > 1.15 * climbed.mu.mean()
    assert trace.columns["tip_error_model_m"].mean() < 2.0 * climbed.columns["tip_error_model_m"].mean()


def test_motion_of_the_receding_horizon_stays_on_the_path():
    one, q = follower(setup()), [setup().q_start]
    for _ in range(setup().ticks):
        q.append(q[-1] + 0.002 * one.desired_velocity(setup().robot.state(q[-1])))
    assert one.told["refused"] <= 0.05 * one.told["solves"]
    t = 0.002 * np.arange(len(q))
    tips, wrists = setup().robot.tool_along(np.array(q))
    # Between the program's nodes the motion is a cubic, so it deviates slightly from the path.
    assert np.linalg.norm(tips - setup().reference.at(t)[0], axis=1).max() < 2e-3
    assert shaft_distance(tips, wrists, setup().registered.at(t)[0]).max() < 2e-3
    # The program limits only mean speeds between its nodes, so the cubic is faster in places.
    assert (np.abs(np.diff(q, axis=0)) / 0.002 <= 1.2 * setup().robot.v_max).all()


@pytest.mark.parametrize("wrong", ["random", "nan", "fast"])
def test_wrong_answers_of_the_nonlinear_program_are_refused(monkeypatch, wrong):
    one, rng = follower(setup()), np.random.default_rng(0)
    robot, q, solve = setup().robot, setup().q_start, Program.solve

    def nonsense(self, guess, *given):
        if wrong == "fast":  # the first step of joint 7 is too long; this joint moves neither tip nor wrist
            right, _ = solve(self, guess, *given)
            return right - np.copysign(2.0, right[0, 6]) * np.eye(7)[6], True
        return (rng.normal(size=guess.shape) if wrong == "random" else np.full_like(guess, np.nan)), True

    monkeypatch.setattr(Program, "solve", nonsense)
    for _ in range(700):
        desired = one.desired_velocity(robot.state(q))
    assert one.told["refused"] == one.told["solves"] - 1 > NODES
    np.testing.assert_allclose(desired, 5.0 * (one._now.q_rad[-1] - q), atol=1e-12)


def test_a_new_course_begins_on_the_old_one_only_if_the_arm_is_near(monkeypatch):
    planner, last, guesses = follower(setup())._planner, follower(setup())._now, []
    on_course, off = last.at(0.1)[0], np.eye(7)[6]  # joint 7 moves neither tip nor wrist
    near, far = (planner.plan(on_course + angle * off, 0.1, last).q_rad[0] for angle in (0.01, 0.1))
    np.testing.assert_array_equal([near, far], [on_course, on_course + 0.1 * off])
    path, solves = planner._value.map.targets, planner.told["solves"]
    for share, more in ((0.49, 0), (0.51, 1)):  # no solve in the path's last half target period
        planner.plan(on_course, path.t_s[-1] - share * path.period_s, last)
        assert planner.told["solves"] == solves + more
    monkeypatch.setattr(Program, "solve", lambda self, guess, *_: guesses.append(guess) or (guess, True))
    for before in (None, last, last._replace(q_rad=last.q_rad + 3.0 * off)):  # the third course is 3 rad off in joint 7
        planner.plan(on_course, 0.1, before)
    assert [np.array_equal(guesses[0], guess) for guess in guesses] == [True, False, True], "only a near course matters"


@pytest.mark.parametrize("level", ["planned", "receding"])
def test_a_repeated_run_has_the_same_desired_velocities(level):
    one, other = follower(setup(level)), follower(setup(level))
    state = setup(level).robot.state(setup(level).q_start)
    first = [one.desired_velocity(state) for _ in range(300 if level == "planned" else 60)]
    assert np.ptp(first, axis=0).max() > 1e-3, "the desired velocity changes with time"
    np.testing.assert_array_equal(first, [other.desired_velocity(state) for _ in first])
    one.start()
    np.testing.assert_array_equal(first, [one.desired_velocity(state) for _ in first])


SCENARIO = mo.Scenario(bound_samples=0, judge=False, duration_s=1.0).change(control={"third_level": "planned"})


@pytest.fixture(scope="module")
def course(tmp_path_factory):
    found, within = followable_plan(SCENARIO)
    saved = save_course(found, SCENARIO, tmp_path_factory.mktemp("course") / "course.parquet", within)
    trace = mo.Trace.load(saved)
    np.testing.assert_array_equal(trace.q_rad, found.from_start.q_rad)
    np.testing.assert_array_equal(trace.columns["swivel_rad"], found.swivel_rad)
    assert trace.meta["from_start"] is True
    return saved


def without_course(scenario):
    return Setup(scenario.change(control={"third_level": "local", "course": ""}))


def loaded(scenario):
    setup = without_course(scenario)
    return load_course(scenario.control, setup.robot, setup.layout.q, targets_of(setup.robot, setup.layout))


def test_a_saved_course_is_followed_like_a_planned_one(course, monkeypatch):
    following, file = without_course(SCENARIO).following, SCENARIO.change(control={"course": str(course)})
    read, made = (followed_course(replace(following, settings=each.control)) for each in (file, SCENARIO))
    assert read.mu_mean == pytest.approx(made.mu_mean, rel=1e-4)
    np.testing.assert_allclose(read.q_rad, made.q_rad, rtol=0.0, atol=1e-2)
    answers = iter([{0.9 * following.brake: None}, {np.inf: made}])  # smoothing fails with a brake limit
    monkeypatch.setattr(guides, "refine", lambda *of, brake, **_: next(answers)[brake] or of[2])
    assert followed_course(replace(following, settings=file.control)) is made


@pytest.mark.parametrize(("change", "message"), [
    ({"duration_s": 0.8}, "it goes from 0 to 1 s, the run from 0 to 0.8"),
    ({"start": {"swivel": 0.3}}, r"begins 0\.\d+ rad from the start of the run; plan it"),
    ({"robot": {"name": "iiwa14"}}, "a course of robot 'lwr4', but the run has 'iiwa14'"),
    ({"control": {"course_speed_fraction": 0.01}}, "plan it with --speed-share 0.01"),
    ({"control": {"course": "nowhere.parquet"}}, "nowhere.*no such file.*moc-opt plan"),
])  # fmt: skip
def test_a_course_of_another_run_is_refused(course, change, message):
    with pytest.raises(ScenarioError, match=message):
        loaded(SCENARIO.change(control={"course": str(course)}).change(**change))


def test_a_file_that_is_no_course_is_refused(course, tmp_path):
    trace, to = mo.Trace.load(course), tmp_path / "other.parquet"
    mine, t, q = SCENARIO.change(control={"course": str(to)}), trace.t_s, trace.q_rad

    def moved(rows, joint, by):
        other = q.copy()
        other[rows, joint] += by
        return {"q_rad": other}

    for columns, meta, message in (
        ({"q_rad": q[:, :6]}, {}, r"q_rad \(\d+, 6\), not floats \(k,\) and \(k, 7\)"),
        (moved(3, 2, np.nan), {}, "a pose is not finite"), ({"t_s": t[::-1].copy()}, {}, "times t_s do not rise"),
        ({"t_s": np.round(t).astype(np.int64)}, {}, "t_s has shape"),
        ({"t_s": np.where(t == t[3], t[2], t)}, {}, "times t_s do not rise"),
        *((moved(slice(9, None), 6, by), {}, r"joint_7 goes 9\d\d\.?\d* rad beyond its limit") for by in (1e3, -1e3)),
        (moved(5, slice(None), 0.05), {}, "mm from its target at t = 0.125 s"),
        ({"t_s": np.maximum(t, 0.01)}, {}, "it goes from 0.01 to 1 s"), ({}, {"kind": "run"}, "holds no course"),
        ({name: rows[:1] for name, rows in trace.columns.items()}, {}, r"t_s has shape \(1,\)"),
        ({name: rows[[0, -1]] for name, rows in trace.columns.items()}, {}, "mm from its target"),
        ({"q_rad": q + 0.1}, {"from_start": False}, r"start of the run; begin the run there: \[start\] q_rad = \["),
    ):  # fmt: skip
        mo.Trace({**trace.columns, **columns}, {**trace.meta, **meta}).save(to)
        with pytest.raises(ScenarioError, match=message):
            loaded(mine)


def test_smoothing_keeps_the_limits_of_a_planned_course(tmp_path):
    within = {"margin_rad": 0.6, "speed_share": 0.1, "shaft_margin": 0.05}
    to = save_course(plan(SCENARIO, **within), SCENARIO, tmp_path / "slow.parquet", within)
    scenario = SCENARIO.change(control={"course": str(to)})
    setup, limits = without_course(scenario), loaded(scenario)[1]
    assert (limits.margin, limits.speed_share, limits.shaft) == pytest.approx((0.6, 0.1, 0.05), abs=1e-6)
    robot, period_s = setup.robot, targets_of(setup.robot, setup.layout).period_s
    slow, fast = (followed_course(replace(setup.following, settings=each.control)) for each in (scenario, SCENARIO))
    shares = [speed_shares(robot, course.q_rad, period_s).max() for course in (slow, fast)]
    assert 0.05 < shares[0] < 0.1 + 1e-6 < 0.3 < shares[1]
    assert np.minimum(slow.q_rad - robot.q_min, robot.q_max - slow.q_rad)[:, :6].min() > 0.6 - 1e-6
    trace = mo.Trace.load(to)
    mo.Trace(trace.columns, {**trace.meta, "within": {"speed_share": 0.01}}).save(to)
    assert 0.05 < loaded(scenario)[1].speed_share < 0.1 + 1e-6, "the limit is at least the speed of the file's course"
