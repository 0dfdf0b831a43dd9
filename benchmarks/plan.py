"""How much mean manipulability is possible along a path, and how much of it does MOC reach with each kind of level 3?

python -m benchmarks.plan [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import partial
from typing import Any, Self, get_args

import numpy as np
from pydantic import Field

from benchmarks.goals import Goal, goals_table, judge
from benchmarks.robots import on_each_arm
from moc_opt.control import ControlSettings
from moc_opt.figures.notation import Mark
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.scenario.planned import plan
from moc_opt.study import Failed, Job, show
from moc_opt.study.command import Found, Study, StudyConfig, command
from moc_opt.study.results import Results, change_name
from moc_opt.study.show import Report, Section, columns
from moc_opt.study.statistics import Interval, mean, spread, too_few
from moc_opt.study.trials import Trial, placed, run_and_trace, seeds

STREAM, LOCAL = 7, "local"
CONTROL = ControlSettings.model_fields
LOOPS: dict[str, dict[str, Any]] = {
    **{level: {"third_level": level} for level in get_args(CONTROL["third_level"].annotation)},
    # "local" with the faster observer that "receding" and "planned" have
    "local, observer of the courses": {"observer_gain_per_s": CONTROL["course_observer_gain_per_s"].default},
}
ERRORS = {"tip": "tip_error_model_mean_mm", "RCM": "rcm_error_model_mean_mm"}
MOST_GAP_PERCENT = {LOCAL: 2.0, "receding": 1.0, "planned": 0.5}
MOST_PLANNED_PERCENT, MOST_CHANGE_PERCENT, TRAPPED_PERCENT = 3.0, 5.0, 5.0
MOST_SCRATCH_S, MOST_REPLAN_MS, MOST_HALVING_PERCENT = 3.0, 20.0, 0.5
FIGURES = ("gap_percent", "fraction_of_best", *ERRORS.values(), "course_gap_percent", "replan_ms_p99")
COURSES = (
    "from_start", "best", "climb_gap_percent", "start_loss_percent", "bound_gap_percent", "refined_percent",
    "halving_percent", "map_s", "search_s", "refine_s", "scratch_s",
)  # fmt: skip
IN_THE_LOOP, ALONG = "In the loop", "Courses and checks"


class Config(StudyConfig):
    robots: list[str] = Field(["lwr4", "iiwa14", "panda"], min_length=1)
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    seed: int = Field(4000, ge=0, description="a course's limits (speeds, margins) were chosen on other seeds")
    poses: int = Field(20, ge=1, description="random starts per task and robot")
    loops: dict[str, dict[str, Any]] = Field(LOOPS, description="changes of [control] for each closed loop, by name")
    halvings: int = Field(3, ge=0, description="starts per robot that are planned again at half the grid spacing")
    scenario: Scenario = Scenario(start={"pose": "random"})

    def quick(self) -> Self:
        few = {"robots": self.robots[:2], "tasks": self.tasks[:1], "poses": 2, "halvings": 1}
        return self.model_copy(update=few)

    def cases(self) -> list[Scenario]:
        drawn = seeds(self.seed, STREAM, self.poses * len(self.tasks) * len(self.robots))
        return on_each_arm(self.scenario, self.robots, self.tasks, drawn)


def about(case: Scenario, part: str) -> dict[str, Any]:
    return {"part": part, "robot": case.robot.name, "trial": case.name, "seed": case.seed, "controller": part,
            "whole": True, "error": None}  # fmt: skip


def courses(case: Scenario, loops: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    trial = placed(case)
    found = plan(trial)
    row = about(case, "courses") | {
        "executable": found.executable, "blocked": "" if found.blocked is None else found.blocked.reason,
        "climbed_whole": found.climbed_whole, **{f"{part}_s": seconds for part, seconds in found.took_s.items()},
        "scratch_s": found.took_s["map"] + found.took_s["search"],
    }  # fmt: skip
    mine, best = found.from_start, found.best
    if mine is None or best is None:
        return [row]
    row |= {
        "from_start": mine.mu_mean, "best": best.mu_mean, "certified": mine.certified, "violation": mine.violation,
        "start_loss_percent": 100.0 * (1.0 - mine.mu_mean / best.mu_mean),
    }  # fmt: skip
    for name, bound, course in (("", found.bound_from_start, mine), ("_best", found.bound, best)):
        if np.isfinite(bound):
            row[f"bound_gap{name}_percent"] = 100.0 * (bound / course.mu_mean - 1.0)
    if found.climbed_whole:
        row["climb_gap_percent"] = 100.0 * (1.0 - found.climbed.mu_mean / mine.mu_mean)
    return [row, *(loop(trial, name, change, mine.mu_mean, best.mu_mean) for name, change in loops.items())]


def loop(trial: Scenario, name: str, change: Mapping[str, Any], mine: float, best: float) -> dict[str, Any]:
    """Run a closed loop. ``mine``: mean mu of the best course from this start. ``best``: the same, from any start."""
    case = trial.change(control=change, best_courses=False, bound_samples=0, judge=False)
    asked = Trial(case, name, case.solver.settings, {"part": "loop"}, solver=case.solver.name)
    run, trace = run_and_trace(asked)
    if trace is None or not run.row["whole"]:
        return dict(run.row)
    mu, replans = run.row["mu_mean"], trace.meta.get("replans", {})
    row = {**run.row, "gap_percent": 100.0 * (1.0 - mu / mine), "fraction_of_best": mu / best}
    if "course_mu_mean" in trace.meta:
        row["course_gap_percent"] = 100.0 * (1.0 - float(trace.meta["course_mu_mean"]) / mine)
    if "left_course_s" in replans:
        row["left_course_s"] = replans["left_course_s"]
    elif replans:
        row["replan_ms_p99"] = replans["solve_ms_p99"]
    return row


def halving(case: Scenario) -> list[dict[str, Any]]:
    """Return the rise of mean mu by refinement, and by halving the grid spacing."""
    found, coarse = plan(case), plan(case, refined=False)
    finer = plan(case, refined=False, times=2 * len(found.targets) - 1, swivels=1440).from_start
    row = about(case, "halving")
    if found.from_start is not None and coarse.from_start is not None:
        base = coarse.from_start.mu_mean
        row["refined_percent"] = 100.0 * (found.from_start.mu_mean / base - 1.0)
        if finer is not None:
            row["halving_percent"] = 100.0 * (finer.mu_mean / base - 1.0)
    return [row]


def work(study: Study, config: Config) -> Found:
    cases, asked = config.cases(), list[tuple[str, Job]]()
    for robot in config.robots:
        own = [case for case in cases if case.robot.name == robot]
        some = own[:: max(1, len(own) // max(config.halvings, 1))][: config.halvings]
        asked += [("courses", Job(courses, (case, config.loops))) for case in own]
        asked += [("halving", Job(halving, (case,))) for case in some]
    rows = Results()
    for (part, job), found in zip(asked, study.run([job for _, job in asked], "plans"), strict=True):
        lost = about(job.arguments[0], part) | {"whole": False, "error": str(found)}
        rows.add(*([lost] if isinstance(found, Failed) else found))
    summary: dict[str, Any] = {"courses": {}, "loops": {}, "goals": {}}
    for robot in config.robots:
        mine = rows.where(robot=robot)
        loops = {name: loop_figures(mine.where(part="loop"), name) for name in config.loops}
        figures = {"loops": loops, "courses": course_figures(mine)}
        for part, of_arm in {**figures, "goals": judge(figures, goals(config.loops))}.items():
            summary[part][robot] = of_arm
    return Found(report(summary, rows, config), summary, rows)


def loop_figures(rows: Results, name: str) -> dict[str, Any]:
    found = rows.figures(name, FIGURES, tuple(ERRORS.values()), LOCAL)
    found["left_course"] = len(rows.values("left_course_s", name))
    for metric in FIGURES:
        if values := rows.values(metric, name):
            found[f"{metric}_max"] = max(values.values())
    if gaps := list(rows.values("gap_percent", name).values()):
        found |= {"gap_percent_median": float(np.median(gaps)), "trapped": sum(gap > TRAPPED_PERCENT for gap in gaps)}
    return found


def course_figures(rows: Results) -> dict[str, Any]:
    planned = rows.where(part="courses")
    found: dict[str, Any] = {"trials": len(planned), "failed": len(planned.failed())}
    flags = ("executable", "climbed_whole", "certified")
    found |= {name: sum(bool(row.get(name)) for row in planned) for name in flags}
    for name in COURSES:
        values = [row[name] for part in ("courses", "halving") for row in rows.where(part=part) if name in row]
        if values:
            found |= mean(values).entries(name) | {f"{name}_max": max(values), f"{name}_abs_max": max(map(abs, values))}
    found["violation_max"] = max((row["violation"] for row in planned if "violation" in row), default=None)
    found["unbounded"] = sum("best" in row and "bound_gap_best_percent" not in row for row in planned)
    return found


def goals(loops: Mapping[str, Any]) -> dict[str, Goal]:
    def interval(name: str, key: str) -> Any:
        def measured(summary: Any) -> Interval:
            of = summary["loops"][name]
            return Interval(of[key], of[f"{key}_low"], of[f"{key}_high"], of["whole"])

        return measured

    found = {
        f"gap {name}": Goal(f"mean gap of mu to the best course ({name})", "%", most, interval(name, "gap_percent"),
                            section=IN_THE_LOOP)
        for name, most in MOST_GAP_PERCENT.items() if name in loops
    }  # fmt: skip
    found["planned worst"] = Goal("largest gap of mu (planned)", "%", MOST_PLANNED_PERCENT,
                                  lambda s: s["loops"]["planned"]["gap_percent_max"], section=IN_THE_LOOP)  # fmt: skip
    for name in ("planned", "receding"):
        for words, error in ERRORS.items():
            found[f"{name} {words}"] = Goal(f"change of the {words} error relative to local ({name})", "%",
                                            MOST_CHANGE_PERCENT, interval(name, change_name(error)),
                                            section=IN_THE_LOOP)  # fmt: skip
    return found | {
        "replan": Goal("p99 of the replanning time in the worst run (receding)", "ms", MOST_REPLAN_MS,
                       lambda s: s["loops"]["receding"]["replan_ms_p99_max"], section=IN_THE_LOOP),
        "scratch": Goal("time of map and search at the slowest start", "s", MOST_SCRATCH_S,
                        lambda s: s["courses"]["scratch_s_max"], section=ALONG),
        "halving": Goal("change of mean mu if the grid spacing is halved", "%", MOST_HALVING_PERCENT,
                        lambda s: s["courses"]["halving_percent_abs_max"], section=ALONG),
    }  # fmt: skip


def report(summary: Mapping[str, Any], rows: Results, config: Config) -> Report:
    first, wide = [], []
    for robot, by in summary["loops"].items():
        for name, found in by.items():
            judged = summary["goals"][robot]
            first.append({
                "robot": robot, "loop": name, **found,
                "gap": _mark(judged.get(f"gap {name}"), found.get("gap_percent"), ".2f"),
                "worst": _mark(judged.get(f"{name} worst"), found.get("gap_percent_max"), ".1f"),
                **{words: _mark(judged.get(f"{name} {words}"), found.get(change_name(error)), "+.0f")
                   for words, error in ERRORS.items()},
            })  # fmt: skip
            spreads = {f"{key} with interval": spread(found, key) for key in ("gap_percent", "course_gap_percent")}
            wide.append({"robot": robot, "loop": name, **found, **spreads})
    table = Table("Gap of mean mu to the best course from the same start", [
        Column("robot", "arm", section=ALONG), Column("loop", "third level"),
        Column("gap", "below best", unit="%", section=IN_THE_LOOP),
        Column("worst", "worst", unit="%", section=IN_THE_LOOP),
        Column("trapped", "trapped", format="d", help=f"number of runs with a gap above {TRAPPED_PERCENT:g} %"),
        Column("tip", "tip", unit="%", section=IN_THE_LOOP, help="change of the tip error relative to local"),
        Column("RCM", "RCM", unit="%", section=IN_THE_LOOP, help="change of the RCM error relative to local"),
    ], first, "✔ the goal is met, ✘ missed, ? undecided. A value with none of these marks has no goal.")  # fmt: skip
    by_robot = [{"robot": robot, **figures} for robot, figures in summary["courses"].items()]
    arm = Column("robot", "arm")
    by_arm = [goals_table(judged, f"Goals, {robot}") for robot, judged in summary["goals"].items()]
    sections = [
        Section("Goals", "", by_arm),
        Section(IN_THE_LOOP, "Means over the completed runs, with 95 % intervals.", [Table("Closed loops", [
            arm, Column("loop", "third level"), *columns("whole", "trials"),
            Column("gap_percent with interval", "below best from start", unit="%"),
            Column("gap_percent_median", "median", unit="%", format=".2f"),
            Column("course_gap_percent with interval", "planned course below best", unit="%"),
            *columns("left_course", "fraction_of_best", *ERRORS.values(), *map(change_name, ERRORS.values()))], wide)]),
        Section(ALONG, "", [
            Table("Courses along the path, means over the trials", [
                arm, *columns("trials", "executable", "climbed_whole"),
                Column("from_start", "mu, best from start", unit="m^3", format=".4f"),
                Column("best", "mu, best over all", unit="m^3", format=".4f"),
                Column("climb_gap_percent", "ideal local climb: mu below best from start", unit="%", format=".2f"),
                Column("climb_gap_percent_max", "largest", unit="%", format=".1f"),
                Column("start_loss_percent", "best from start below best over all", unit="%", format=".2f"),
                Column("start_loss_percent_max", "largest", unit="%", format=".1f")], by_robot),
            Table("Checks of the courses", [
                arm, Column("certified", "local optima", format="d"),
                Column("violation_max", "largest violation", unit="m, rad", format=".0e"),
                Column("bound_gap_percent", "bound above course", unit="%", format=".3f"),
                Column("unbounded", "trials whose best course exceeds the bound", format="d"),
                Column("refined_percent", "gain by refinement", unit="%", format=".3f"),
                Column("halving_percent_abs_max", "halving the grid", unit="%", format=".3f"),
                Column("map_s", "map", unit="s", format=".2f"), Column("search_s", "search", unit="s", format=".2f"),
                Column("scratch_s_max", "map and search, slowest", unit="s", format=".2f"),
                Column("refine_s", "refinement", unit="s", format=".2f")], by_robot)]),
    ]  # fmt: skip
    title = f"{', '.join(config.robots)}: manipulability of planned courses and of MOC"
    return Report(title, sentences(rows, config), table, sections=sections)


def _mark(goal: Mapping[str, Any] | None, value: float | None, form: str) -> Mark | str | None:
    if value is None:
        return None
    return show.mark(goal["reached"], format(value, form)) if goal else format(value, form)


def sentences(rows: Results, config: Config) -> list[str]:
    every = {name: list(rows.values("gap_percent", name).values()) for name in config.loops}
    said = [
        f"{name} {mean(gaps):.2f} % (largest {max(gaps):.1f}, {too_few(len(gaps)) or f'{len(gaps)} runs'})"
        for name, gaps in every.items() if gaps
    ]  # fmt: skip
    if not said:
        return ["No run completed its task. The errors are below."]
    local = every.get(LOCAL, [])
    trapped = sum(gap > TRAPPED_PERCENT for gap in local)
    return [
        f"Gap of mean mu to the best course from the same start: {'; '.join(said)}.",
        f"From {trapped} of {len(local)} starts, mean mu of `local` is more than {TRAPPED_PERCENT:g} % below that of "
        "the best course.",
    ]


main = partial(command, "plan", "How much manipulability is possible along a path.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
