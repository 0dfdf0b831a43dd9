"""Which of FINDINGS hold on which arm?

python -m benchmarks.robots [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any, Self

import numpy as np
from pydantic import Field
from scipy import stats

from benchmarks.goals import Goal, judge
from benchmarks.phases import with_phases
from moc_opt.figures.style import BAD, GOOD, WORST
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study.command import Found, Study, StudyConfig, command
from moc_opt.study.results import ERRORS, FRAMES, TITLES, Results, change_name
from moc_opt.study.show import MARKS, Picture, Report, Section, columns, ends, intervals_picture, mark
from moc_opt.study.statistics import Change, Interval, share, spread, too_few
from moc_opt.study.trials import BASELINE, Trial, seeds, trials

STREAM = 8
MEANS = (
    "mu_mean", "mu_fraction_of_bound", "mu_fraction_of_best_from_start", "mu_fraction_of_best", *ERRORS,
    "trocar_force_mean_N", "torque_rate_rms_Nm_per_s", "infeasible",
)  # fmt: skip
SETTLED = {f"settled_{name}": title for name, title in TITLES.items()}
CHANGES = ("mu_mean", "trocar_force_mean_N", "torque_rate_rms_Nm_per_s", *SETTLED)
LEAST_GAIN_PERCENT, MOST_CHANGE_PERCENT, MUCH_WORSE, MOST_TAILS = 10.0, 5.0, 1.1, 0.1
FINDINGS: Mapping[str, str] = {
    "all_end": "every run completes its task",
    "mu_gain_percent": "mean mu rises by 10 % or more",
    **{change_name(name): f"settled error ({title}) at most 5 % above DCAC's" for name, title in SETTLED.items()},
    "tails": "at most 10 % of all trials have a tip error (base frame) more than 10 % above DCAC's",
}  # fmt: skip
DRAWN = ("mu_gain_percent", *(change_name(f"settled_{ERRORS[k]}") for k in (1, 4)))


class Config(StudyConfig):
    robots: list[str] = Field(["lwr4", "iiwa14", "panda", "gen3", "xarm7", "lwr4_rail"], min_length=1)
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    starts: int = Field(5, ge=1, description="random starts per task and robot")
    solvers: list[str] = Field(["exact", "osqp", "proxqp", "rnn", "nlp-sqp"], min_length=1)
    scenario: Scenario = Scenario(start={"pose": "random"}, bound_samples=10)

    def quick(self) -> Self:
        return self.model_copy(update={"tasks": self.tasks[:1], "starts": 2, "solvers": self.solvers[:2]})

    def cases(self) -> list[Scenario]:
        drawn = seeds(self.seed, STREAM, self.starts * len(self.tasks) * len(self.robots))
        return on_each_arm(self.scenario, self.robots, self.tasks, drawn)


def on_each_arm(
    base: Scenario, robots: Sequence[str], tasks: Sequence[str], own_seeds: Sequence[int]
) -> list[Scenario]:
    count = len(own_seeds) // len(robots)
    arms = [base.change(robot={"name": name}) for name in robots]
    return [
        case for k, arm in enumerate(arms)
        for case in trials(arm, tasks, own_seeds[k * count : (k + 1) * count], virtual=True)
    ]  # fmt: skip


def work(study: Study, config: Config) -> Found:
    starts, lost = study.placed(config.cases())
    asked = [
        Trial(case.change(best_courses=True), name, keep="curves")
        for case in starts for name in (BASELINE, *config.solvers)
    ]  # fmt: skip
    rows = Results([*(run.row for run in with_phases(study.trials(asked))), *lost])
    arms = {arm: rows.where(robot=arm) for arm in config.robots}
    figures = {arm: {name: mine.figures(name, MEANS, CHANGES) for name in mine.names()} for arm, mine in arms.items()}
    judged = "exact" if "exact" in config.solvers else config.solvers[0]
    findings = {arm: verdicts(mine, judged) for arm, mine in arms.items()}
    summary = {"robots": figures, "findings": findings, "ranking": ranking(figures)}
    return Found(report(summary, judged), summary, rows)


def verdicts(rows: Results, judged: str) -> dict[str, bool | None]:
    """Return whether each finding holds, or None if it is undecided."""
    own, base = rows.pairs("tip_error_mean_mm", judged)

    def change(metric: str, _: Any) -> Change | None:
        return rows.change(metric, judged)

    def tails(_: Any) -> Interval:
        return share(sum(a > MUCH_WORSE * b for a, b in zip(own, base, strict=True)), len(own))

    goals = {
        "mu_gain_percent": Goal("", "%", LEAST_GAIN_PERCENT, partial(change, "mu_mean"), most=False),
        **{change_name(name): Goal("", "%", MOST_CHANGE_PERCENT, partial(change, name)) for name in SETTLED},
        "tails": Goal("", "", MOST_TAILS, tails),
    }
    broken = any(not row["whole"] for row in rows)
    return {
        "all_end": False if broken else None if too_few(len(own)) else True,
        **{key: {"yes": True, "no": False}.get(row["reached"]) for key, row in judge({}, goals).items()},
    }


def ranking(robots: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Rank the solvers on each arm by mean mu, and correlate the ranks of every two arms."""
    scores, between = {}, {}
    for robot, figures in robots.items():
        found = {name: row["mu_mean"] for name, row in figures.items() if name != BASELINE and "mu_mean" in row}
        scores[robot] = {name: round(mu / max(found.values()), 3) for name, mu in found.items()}
    for one, two in combinations(scores, 2):
        shared = [name for name in scores[one] if name in scores[two]]
        if len(shared) > 2 and all(len({by[name] for name in shared}) > 1 for by in (scores[one], scores[two])):
            rho = stats.spearmanr([scores[one][n] for n in shared], [scores[two][n] for n in shared]).statistic
            between[f"{one}, {two}"] = float(rho)
    order = {robot: sorted(by, key=lambda name: -by[name]) for robot, by in scores.items()}
    return {"order": order, "between": between, "mean": float(np.mean(list(between.values()))) if between else None}


def report(summary: Mapping[str, Any], judged: str) -> Report:
    arms, findings = summary["robots"], summary["findings"]
    first = []
    for arm, by in arms.items():
        percents = {key: by.get(judged, {}).get(key) for key in FINDINGS}
        texts = {key: "" if value is None else f"{round(value):+d}" for key, value in percents.items()}
        first.append({"robot": arm, **{key: mark(findings[arm][key], text) for key, text in texts.items()}})
    headings = {"mu_gain_percent": "mu", **{change_name(name): title for name, title in SETTLED.items()}}
    table = Table(
        f"MOC with {judged} against DCAC with the same gains, on every arm",
        [Column("robot", "arm", section="All figures"),
         *(Column(key, title, unit="%", section="Findings", help=FINDINGS[key]) for key, title in headings.items())],
        first, f"✔: the whole 95 % interval meets the criterion (mu: at least +{LEAST_GAIN_PERCENT:g} %; "
        f"settled errors: at most +{MOST_CHANGE_PERCENT:g} %). ✘: no part of it does. ?: only a part does.",
    )  # fmt: skip
    every = [{"robot": arm, "controller": name, **row} for arm, by in arms.items() for name, row in by.items()]
    marks = [
        {"finding": text, **{arm: MARKS[by[key]] for arm, by in findings.items()}} for key, text in FINDINGS.items()
    ]
    order = [{"robot": arm, "order": ", ".join(names)} for arm, names in summary["ranking"]["order"].items()]
    arm_column = Column("robot", "arm")
    sections = [
        Section("All figures", "Whole: number of completed runs. Means are over these runs. Settled errors: means over "
                f"ticks at which the elbow rests in all runs of a trial. {FRAMES}", [Table("Every arm and controller", [
                    arm_column, Column("controller", "controller"),
                    *columns("trials", "whole", *headings, *MEANS, **headings)], every)]),
        Section("Findings", "", [Table("Which findings hold on which arm", [
            Column("finding", "finding"), *(Column(arm, arm) for arm in arms)], marks)]),
        Section("Solvers", "", [Table("Solvers by mean mu, best first", [arm_column, Column("order", "order")],
                                      order)]),
    ]  # fmt: skip
    title = f"MOC with {judged} against DCAC on {', '.join(arms)}"
    return Report(title, sentences(summary, judged), table, pictures(summary, judged), sections)


def sentences(summary: Mapping[str, Any], judged: str) -> list[str]:
    mine = {arm: by[judged] for arm, by in summary["robots"].items() if "mu_gain_percent" in by.get(judged, {})}
    if not mine:
        return [f"No trial was completed by both {judged} and DCAC."]
    few = [arm for arm, row in mine.items() if too_few(row["compared"])]
    counts = sorted({row["compared"] for row in mine.values()})
    each = " to ".join(map(str, dict.fromkeys([counts[0], counts[-1]])))
    gains = ", ".join(f"{arm} {spread(row, 'mu_gain_percent', sign='+')} %" for arm, row in mine.items())
    return [
        f"Change of mean mu with {judged} relative to DCAC with the same gains, {each} random poses per arm: {gains}."
        + (f" {', '.join(few)}: {too_few(counts[0])}." if few else "")
    ]


def pictures(summary: Mapping[str, Any], judged: str) -> list[Picture]:
    found = []
    for key in DRAWN:
        drawn = {arm: e for arm, by in summary["robots"].items() if (e := ends(by.get(judged, {}), key)) is not None}
        goal = LEAST_GAIN_PERCENT if key == DRAWN[0] else MOST_CHANGE_PERCENT
        tones = {arm: {True: GOOD, False: WORST, None: BAD}[summary["findings"][arm][key]] for arm in drawn}
        if drawn:
            held = sum(summary["findings"][arm][key] is True for arm in drawn)
            says = f"{FINDINGS[key]}: on {held} of {len(drawn)} arms. Bars: 95 % intervals over the trials."
            title = key.removesuffix("_percent").replace("_", " ") + " [%]"
            found.append(Picture(intervals_picture(drawn, title, {"no change": 0.0, "goal": goal}, tones), says, key))
    return found


main = partial(command, "robots", "Which findings hold on which arm.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
