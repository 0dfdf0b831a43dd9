"""Do the paper's claims hold in simulation? MOC is compared with DCAC on the paper's three virtual tasks.

python -m benchmarks.paper [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

DCAC is MOC without its third level. MOC runs with Table I of the paper (its parameters) as printed, and with tuned
values. DCAC runs with the paper's gains for DCAC, and with the gains of MOC.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field

from benchmarks.goals import Goal, goals_table, judge
from benchmarks.phases import with_phases
from benchmarks.procedure import ProcedureSettings, perform
from moc_opt.control import ControlSettings
from moc_opt.errors import UnknownNameError
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import GOOD, MUTED, SERIES, WORST
from moc_opt.inputs.settings import Name, Settings
from moc_opt.planning.self_motion import self_motion
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job, show
from moc_opt.study.command import Found, Study, StudyConfig, command, runnable
from moc_opt.study.results import ERRORS, FRAMES, PHASES, TITLES, Results, change_name
from moc_opt.study.show import Picture, Report, Section, columns, ends
from moc_opt.study.statistics import Change, Interval, difference_of_changes, spread, too_few
from moc_opt.study.trials import BASELINE, BASELINES, DAMPED, OWN, Trial, seeds, trials
from moc_opt.vision.board import board_task

STREAM = 0
PRINTED, NETWORK = "paper", "rnn"
"""PRINTED: the group of runs with Table I as printed; NETWORK: the paper's solver, a recurrent neural network"""
HOLDS, GAINS_ONLY, FAILS, UNDECIDED = "holds", "holds only against DCAC with softer gains", "does not hold", "undecided"
MARKS = {HOLDS: ("✔", "good", 0), GAINS_ONLY: ("≈", "fair", 1), FAILS: ("✘", "bad", 2)}
TONES = {HOLDS: GOOD, GAINS_ONLY: list(SERIES)[4], FAILS: WORST}
LEAST_GAIN_PERCENT, MOST_CHANGE_PERCENT = 15.0, 5.0  # goals: gain of mean mu, rise of errors after the elbow's travel
MOST_MM = {
    "tip_error_model_mean_mm": 0.1, "tip_error_registered_mean_mm": 0.1, "rcm_error_model_mean_mm": 0.2,
    "rcm_error_registered_mean_mm": 0.2, "rcm_error_mean_mm": 0.5,
}  # fmt: skip
RULES = (
    "An effect compares MOC with a DCAC on the same trials. It has two numbers, each with a 95 % interval: the change "
    "of the mean, 100 (mean MOC / mean DCAC - 1), and the mean of the trials' changes. A claim is confirmed against a "
    "DCAC if both intervals lie on the claimed side of its bound. It holds if it is confirmed against DCAC with MOC's "
    "gains (MOC without its third level). It is undecided if the two numbers of this comparison lie on different sides "
    "of the bound, or if the bound is in only one of their two intervals. Otherwise, if it is confirmed against DCAC "
    "with the paper's (softer) gains, it is said to hold only against softer gains. Fewer than eight trials decide "
    "nothing. The force at the trocar is not judged: it follows the RCM error. Damped DCAC has MOC's gains, and its "
    "self-motion is damped."
)


@dataclass(frozen=True)
class Claim:
    """The claim that a metric's change is above (``upwards``) or below ``bound`` [%]."""

    metric: str
    title: str
    text: str
    bound: float = 0.0
    upwards: bool = False
    papers: bool = True  # whether the paper makes this claim

    def confirmed(self, effect: Change | None) -> bool:
        return effect is not None and effect.side(self.bound) == (1 if self.upwards else -1)

    def verdict(self, own: Change | None, matched: Change | None) -> str:
        """Judge by the changes against DCAC with the paper's gains for DCAC (``own``), and with MOC's (``matched``)."""
        few = too_few(matched.ratio.samples if matched else 0)
        if matched is None or few:
            return str(few)
        if self.confirmed(matched):
            return HOLDS
        if disagree(matched, self.bound):
            return UNDECIDED
        return GAINS_ONLY if self.confirmed(own) else FAILS


CLAIMS = (
    Claim("mu_mean", "mu", "manipulability rises by more than 7 %", 7.0, upwards=True),
    Claim(ERRORS[0], TITLES[ERRORS[0]], "tip accuracy is better"),
    Claim(ERRORS[3], TITLES[ERRORS[3]], "the RCM error is smaller"),
    Claim(ERRORS[1], TITLES[ERRORS[1]], "the tip is nearer to its path in the patient's frame", papers=False),
    Claim(ERRORS[2], TITLES[ERRORS[2]], "the tip is nearer to its path in the base frame", papers=False),
    Claim(ERRORS[4], TITLES[ERRORS[4]], "the shaft is nearer to the incision in the patient's frame", papers=False),
    Claim(ERRORS[5], TITLES[ERRORS[5]], "the shaft is nearer to the true trocar", papers=False),
)


def disagree(change: Change, bound: float) -> bool:
    """Tell whether the two numbers lie on different sides of a bound [%], or only one interval contains it."""
    sides = {(one.low > bound, one.high < bound) for one in change}
    return len(sides) > 1 or (change.ratio.value > bound) != (change.ratios.value > bound)


class Group(Settings):
    KIND: ClassVar[str] = "[groups.*]"
    about: str = ""
    control: dict[str, Any] = Field(default_factory=dict)
    task: dict[str, Any] = Field(default_factory=dict)
    start: dict[str, Any] = Field(default_factory=dict)


class Case(Settings):
    """Table I with some entries replaced."""

    KIND: ClassVar[str] = "[ablation.cases.*]"
    about: str = ""
    control: dict[str, Any] = Field(default_factory=dict, description="the settings that replace entries")
    without: list[str] = Field(default_factory=list, description="settings put back to the package's default")
    controller: str = Field("exact", description="a solver of the third level, or 'dcac-damped'")


class Ablation(Settings):
    """The first case is Table I as printed."""

    KIND: ClassVar[str] = "[ablation]"
    group: str = Field(PRINTED, description="the group whose parameters and trials are used")
    cases: dict[str, Case] = Field(default_factory=dict)


class Swivel(Settings):
    """Runs that start at different swivels."""

    KIND: ClassVar[str] = "[swivel]"
    group: str = "tuned"
    task: str = "circle"
    starts: int = Field(15, ge=2)


class Config(StudyConfig):
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    trials: int = Field(5, ge=1, description="per task")
    solvers: list[str] = Field(["exact", "rnn", "rnn-printed"], min_length=1)
    best: str = "tuned"
    best_solver: str = "exact"
    elsewhere: str | None = Field(None, description="a group with other starts, on which the goals are judged too")
    groups: dict[Name, Group] = Field(default_factory=dict, min_length=1)
    ablation: Ablation = Ablation()
    swivel: Swivel = Swivel()
    procedure: ProcedureSettings = ProcedureSettings()
    scenario: Scenario = Scenario(judge=False)

    @classmethod
    def load(cls, path: Path, seed: int | None = None) -> Self:
        config = super().load(path, seed)
        table_1 = config.ablation
        for group in (config.best, config.swivel.group, config.elsewhere, table_1.group if table_1.cases else None):
            if group is not None and group not in config.groups:
                raise UnknownNameError("group", group, config.groups)
        if config.best_solver not in config.solvers:
            raise UnknownNameError("best_solver", config.best_solver, config.solvers)
        board_task(config.swivel.task)
        runnable([*config.solvers, *(case.controller for case in table_1.cases.values())], *BASELINES)
        for base in (*map(config.base, config.groups), *map(config.changed, table_1.cases.values())):
            config.cases(base)
        return config

    def quick(self) -> Self:
        cases = dict(islice(self.ablation.cases.items(), 2))
        return self.model_copy(update={
            "tasks": self.tasks[:1], "trials": 2, "swivel": self.swivel.model_copy(update={"starts": 3}),
            "procedure": self.procedure.model_copy(update={"film": False}),
            "ablation": self.ablation.model_copy(update={"cases": cases}),
        })  # fmt: skip

    def base(self, group: str) -> Scenario:
        table = self.groups[group]
        return self.scenario.change(control=table.control, task=table.task, start=table.start)

    def changed(self, case: Case) -> Scenario:
        for name in case.without:
            if name not in ControlSettings.model_fields:
                raise UnknownNameError("[ablation.cases.*] without", name, ControlSettings.model_fields)
        defaults = {name: getattr(ControlSettings(), name) for name in case.without}
        return self.base(self.ablation.group).change(control={**case.control, **defaults}, bound_samples=0)

    def cases(self, base: Scenario | None = None) -> list[Scenario]:
        own = seeds(self.seed, STREAM, self.trials * len(self.tasks))
        return trials(base or self.base(self.best), self.tasks, own, virtual=True)


def work(study: Study, config: Config) -> Found:
    asked = [
        Trial(case.change(best_courses=True), name, tags={"part": "trials", "group": group}, keep="curves")
        for group in config.groups for case in config.cases(config.base(group))
        for name in (*BASELINES, *config.solvers)
    ]  # fmt: skip
    asked += [
        Trial(case, name, tags={"part": "ablation", "group": key})
        for key, exchange in config.ablation.cases.items()
        for case in config.cases(config.changed(exchange)) for name in (BASELINE, exchange.controller)
    ]  # fmt: skip
    rows = Results(run.row for run in with_phases(study.trials([*asked, *swivel_trials(config)])))
    film = study.out / "film.webm" if config.procedure.film else None
    study.out.mkdir(parents=True, exist_ok=True)
    base = config.base(config.best).change(solver={"name": config.best_solver})
    jobs = [
        Job(perform, (config.procedure, base.change(seed=seed), task, film if task == config.tasks[0] else None))
        for task, seed in zip(config.tasks, seeds(config.seed, STREAM, len(config.tasks)), strict=True)
    ]
    procedure = {
        task: {"ended": "failed", "error": str(row)} if isinstance(row, Failed) else row
        for task, row in zip(config.tasks, study.run(jobs, "procedure"), strict=True)
    }
    summary: dict[str, Any] = {
        "groups": {group: group_figures(rows.where(part="trials", group=group)) for group in config.groups},
        "claims": [
            row for group in config.groups for solver in config.solvers
            for row in claims(rows.where(part="trials", group=group), group, solver)
        ],
        "goals": goals(rows, config.best, config.best_solver),
        "goals_elsewhere": goals(rows, config.elsewhere, config.best_solver) if config.elsewhere else {},
        "ablation": ablation(rows.where(part="ablation"), config.ablation.cases),
        "swivel": swivel(rows.where(part="swivel"), config.best_solver),
        "procedure": procedure,
    }  # fmt: skip
    rows.add(*({"part": "procedure", "task": task, **row} for task, row in procedure.items()))
    files = ["film.webm"] if film and film.exists() else []
    return Found(report(summary, rows, config), summary, rows, files=files)


def group_figures(rows: Results) -> dict[str, dict[str, Any]]:
    """Return each controller's means, and its changes against DCAC with MOC's gains."""
    changed = ["mu_mean", *ERRORS, "trocar_force_mean_N"]
    phases = [f"{phase}_{name}" for phase in PHASES for name in (*ERRORS, "trocar_force_mean_N")]
    means = ["mu_mean", "mu_fraction_of_best", *ERRORS, "trocar_force_mean_N", "torque_rate_rms_Nm_per_s"]
    found = {}
    for name in rows.names():
        shook = sum(str(row["ended"]).startswith("oscillated") for row in rows.where(controller=name))
        found[name] = rows.figures(name, means, [*changed, *phases]) | {"oscillated": shook}
    return found


def claims(rows: Results, group: str, solver: str) -> list[dict[str, Any]]:
    found = []
    for claim in CLAIMS:
        effects = {name: rows.change(claim.metric, solver, name) for name in BASELINES}
        row: dict[str, Any] = {
            "group": group, "controller": solver, "claim": claim.metric, "text": claim.text,
            "verdict": claim.verdict(effects[OWN], effects[BASELINE]),
        }  # fmt: skip
        for name, key in ((OWN, "own"), (BASELINE, "matched"), (DAMPED, "damped")):
            change = effects[name]
            row |= change.entries(f"{key}_percent") if change is not None else {}
        found.append(row)
    return found


def gains(rows: Results, solver: str) -> list[float]:
    """Return each trial's gain of mean mu [%] over DCAC with MOC's gains."""
    mine, theirs = rows.pairs("mu_mean", solver)
    return [100.0 * (a / b - 1.0) for a, b in zip(mine, theirs, strict=True)]


def goals(rows: Results, group: str | None, solver: str) -> dict[str, dict[str, Any]]:
    mine = rows.where(part="trials", group=group)

    def change(metric: str) -> Callable[[Any], Change | None]:
        return lambda _: mine.change(metric, solver)

    def mean(metric: str) -> Callable[[Any], Interval | None]:
        return lambda _: mine.mean(metric, solver)

    each = gains(mine, solver)
    worst = Interval(min(each), min(each), min(each), len(each)) if each else None
    return judge({}, {
        "mu_gain": Goal("gain in mean mu", "%", LEAST_GAIN_PERCENT, change("mu_mean"), most=False),
        "mu_worst": Goal(f"smallest gain in mean mu of {len(each)} trials", "%", 0.0, lambda _: worst, most=False),
        **{f"settled_{name}": Goal(f"change of the settled error ({title})", "%", MOST_CHANGE_PERCENT,
                                   change(f"settled_{name}")) for name, title in TITLES.items()},
        **{name: Goal(f"mean error ({TITLES[name]})", "mm", limit, mean(name)) for name, limit in MOST_MM.items()},
    })  # fmt: skip


def ablation(rows: Results, cases: Mapping[str, Case]) -> list[dict[str, Any]]:
    """Return one row per case and claim of the paper. The effect is the change against DCAC. The shift is the effect
    minus that of Table I as printed.

    A case decides a claim if its effect and that of Table I as printed lie on opposite sides of the claim's bound, the
    95 % interval of the difference of the two effects excludes zero, and there are at least eight trials.
    """
    found, printed = [], next(iter(cases), "")
    for name, case in cases.items():
        for claim in (claim for claim in CLAIMS if claim.papers):
            change = rows.where(group=name).change(claim.metric, case.controller)
            if change is None:
                continue
            row = {"case": name, "about": case.about, "controller": case.controller, "claim": claim.title,
                   "trials": change.ratio.samples, "confirmed": claim.confirmed(change),
                   **change.entries("effect_percent")}  # fmt: skip
            found.append(row | (_shift(rows, cases, name, printed, claim) if name != printed else {}))
    return found


def _shift(rows: Results, cases: Mapping[str, Case], name: str, printed: str, claim: Claim) -> dict[str, Any]:
    """Return the case's shift [percentage points], and whether the case decides the claim."""
    four = [
        rows.where(group=case).values(claim.metric, controller)
        for case in (name, printed) for controller in (cases[case].controller, BASELINE)
    ]  # fmt: skip
    both = sorted(set.intersection(*(set(values) for values in four)))
    if not both:
        return {}
    here, there, before, base = ([values[trial] for trial in both] for values in four)
    shift = difference_of_changes(here, there, before, base)
    beyond = [100.0 * (sum(a) / sum(b) - 1.0) > claim.bound for a, b in ((here, there), (before, base))]
    decides = beyond[0] != beyond[1] and shift.low * shift.high > 0.0 and not too_few(len(both))
    return {**shift.entries("shift_percent"), "decides": decides}


def swivel_trials(config: Config) -> list[Trial]:
    """Return trials that start at poses along a self-motion. One of these poses has the curve's largest mu."""
    base = config.base(config.swivel.group)
    [trial] = trials(base, [config.swivel.task], seeds(config.seed, STREAM, 1), virtual=True)
    robot = trial.robot.arm()
    curve = self_motion(robot, robot.data.q_home if trial.start.q_rad is None else trial.start.q_rad)
    top = float((curve.s[np.argmax(curve.mu)] - curve.s[0]) / (curve.s[-1] - curve.s[0]))
    fractions = np.linspace(0.05, 0.95, config.swivel.starts)
    places = [(at, q, False) for at, q in zip(fractions.tolist(), curve.at(fractions), strict=True)]
    found = []
    for at, pose, best in sorted([*places, (top, curve.best, True)], key=lambda place: place[0]):
        start = {"pose": "home", "q_rad": tuple(pose.tolist()), "swivel": "given"}
        case = trial.change(start=start, name=f"start {at:.4f}")
        tags = {"part": "swivel", "fraction": at, "mu_start": robot.state(pose).mu, "at_maximum": best}
        found += [Trial(case, name, tags=tags) for name in (BASELINE, config.best_solver)]
    return found


def swivel(rows: Results, solver: str) -> dict[str, Any]:
    """Return the gain of mean mu [%] of the run that starts at the largest mu, and the range of the others' gains."""
    top, others = (rows.where(at_maximum=best) for best in (True, False))
    found: dict[str, Any] = {"starts": len(rows) // 2, "broke_off": len(rows.failed())}
    if (of_top := gains(top, solver)) and (of_others := gains(others, solver)):
        change = others.change("mu_mean", solver)
        found |= {
            "gain_at_maximum_percent": of_top[0], "gain_min_percent": min(of_others),
            "gain_max_percent": max(of_others), "gain_mean_percent": change.ratio.value if change else None,
        }  # fmt: skip
    return found


# --- the report ---


def report(summary: Mapping[str, Any], rows: Results, config: Config) -> Report:
    by: dict[tuple[str, str], dict[str, Any]] = {}
    for row in summary["claims"]:
        by.setdefault((row["group"], row["controller"]), {})[row["claim"]] = row
    groups = list(config.groups)
    shook = {(group, solver): summary["groups"][group][solver]["oscillated"] for group, solver in by}
    shown = [
        {"name": f"{group}, {solver}" + (f"; {shook[group, solver]} oscillate" if shook[group, solver] else ""),
         **{claim: _mark(row) for claim, row in by[group, solver].items()}}
        for group, solver in sorted(by, key=lambda key: (key[0] != PRINTED, groups.index(key[0]), key[1] != NETWORK))
    ]  # fmt: skip
    count = config.trials * len(config.tasks)
    table = Table(
        f"Do the paper's claims hold? Change against DCAC with the same gains, {count} trials",
        [Column("name", "parameters, solver", section="Claims"),
         *(Column(claim.metric, claim.title, unit="%", section="Claims", help=claim.text) for claim in CLAIMS)],
        shown, f"✔ the claim {HOLDS}; ≈ it holds only against DCAC with the paper's softer gains; ✘ it {FAILS}; "
        f"? {too_few(count) or UNDECIDED}. The claims: mu rises by more than {CLAIMS[0].bound:g} %, errors fall. Only "
        "mu, tip (model) and RCM (model) are claims of the paper.",
    )  # fmt: skip
    answer = []
    for solver in (name for name in (NETWORK, "exact") if (PRINTED, name) in by):
        claimed = {claim.title: by[PRINTED, solver][claim.metric] for claim in CLAIMS if claim.papers}
        held = sum(row["verdict"] == HOLDS for row in claimed.values())
        effects = [f"{title} {spread(row, 'matched_percent', sign='+') or '?'}" for title, row in claimed.items()]
        answer.append(
            f"Solver {solver}, parameters of Table I: {too_few(count) or f'{held} of {len(claimed)} claims hold'}, and "
            f"{shook[PRINTED, solver]} of {count} runs oscillate. Changes against DCAC with the same gains [%]: "
            f"{'; '.join(effects)}."
        )
    return Report(
        f"LWR4+, three tasks: the paper's claims with {', '.join(config.solvers)}", answer, table,
        [*_effects(by), *_swivel_picture(rows, summary)], list(_sections(summary, config)),
    )  # fmt: skip


def _mark(row: Mapping[str, Any]) -> Mark:
    value = row.get("matched_percent")
    text = "" if value is None else f"{value:+.{1 if abs(value) < 9.95 else 0}f}"
    if row["verdict"] not in MARKS:
        return show.mark(None, text)
    symbol, tone, rank = MARKS[row["verdict"]]
    return Mark(symbol, text, tone, rank)


def _effects(by: Mapping[Any, Any]) -> list[Picture]:
    rows = {
        f"{solver}: {claim.title}": claims[claim.metric]
        for (group, solver), claims in by.items() for claim in CLAIMS if group == PRINTED and claim.papers
    }  # fmt: skip
    found = {name: at for name, row in rows.items() if (at := ends(row, "matched_percent")) and at[0] < at[2]}
    if not found:
        return []
    tones = {name: TONES.get(rows[name]["verdict"], MUTED) for name in found}
    lines = {"no change": 0.0, f"claimed for mu: +{CLAIMS[0].bound:g}": CLAIMS[0].bound}
    says = "Table I as printed: change against DCAC with the same gains, with 95 % intervals over the trials."
    return [Picture(show.intervals_picture(found, "change [%]", lines, tones), says, "claims")]


def _swivel_picture(rows: Results, summary: Mapping[str, Any]) -> list[Picture]:
    mine, found = rows.where(part="swivel"), summary["swivel"]
    if "gain_at_maximum_percent" not in found:
        return []
    [solver] = (name for name in mine.names() if name != BASELINE)
    each = {row["fraction"]: gains(mine.where(trial=row["trial"]), solver) for row in mine.where(controller=solver)}
    lines = {f"MOC with {solver}": [(x, *gain * 3) for x, gain in each.items() if gain]}
    drawn = show.lines_picture(lines, "start: 0 and 1 are the ends of the feasible self-motion", "gain of mean mu [%]")
    says = (
        f"The gain depends on the start of the elbow: {found['gain_at_maximum_percent']:.2g} % from the start with the "
        f"largest mu, and up to {found['gain_max_percent']:.0f} % from the others."
    )
    return [Picture(drawn, says, "swivel")]


def _sections(summary: Mapping[str, Any], config: Config) -> Iterable[Section]:
    yield Section("Claims", f"{RULES} {FRAMES}", [Table(
        f"Group {group}: {config.groups[group].about}", [
            Column("text", "claim"), Column("controller", "solver"), Column("verdict", "verdict"),
            Column("matched", "against DCAC, same gains", unit="%"),
            Column("own", "against DCAC, paper's gains", unit="%"), Column("damped", "against damped DCAC", unit="%"),
        ], [{**row, **{key: spread(row, f"{key}_percent", sign="+") for key in ("matched", "own", "damped")}}
            for row in summary["claims"] if row["group"] == group])
        for group in config.groups])  # fmt: skip
    for key, group in (("goals", config.best), ("goals_elsewhere", config.elsewhere)):
        if summary[key]:
            table = goals_table(summary[key], f"Goals of MOC with {config.best_solver}, group {group}")
            yield Section(f"Goals, group {group}", FRAMES, [table])
    for group in config.groups:
        by = summary["groups"][group]
        phases = {change_name(f"{phase}_{name}"): f"{phase}: {TITLES[name]}" for phase in PHASES for name in ERRORS}
        named = [Column("name", "controller")]
        figures = [{"name": BASELINES.get(name, f"MOC, {name}"), **row} for name, row in by.items()]
        yield Section(f"Group {group}", config.groups[group].about, [
            Table("Means over the runs that completed the task", [*named, *columns(
                "whole", "oscillated", "mu_gain_percent", "mu_mean", "mu_fraction_of_best", *ERRORS,
                "trocar_force_mean_N", "torque_rate_rms_Nm_per_s")], figures),
            Table("Changes against DCAC with the same gains while the elbow travels, and once it has settled",
                  [*named, *columns(*phases, **phases)], figures)])  # fmt: skip
    if summary["ablation"]:
        exchanged = [
            {**row, "effect": spread(row, "effect_percent", sign="+"), "shift": spread(row, "shift_percent", sign="+")}
            for row in summary["ablation"]
        ]
        rule = str(ablation.__doc__).split("\n\n")[1]
        yield Section("Which entry of Table I decides", rule, [Table(
            "Table I with entries replaced, against DCAC with the same gains", [
                Column("about", "case"), Column("claim", "claim"), Column("effect", "effect", unit="%"),
                Column("shift", "shift from Table I", unit="points"), Column("decides", "decides"),
            ], exchanged)])  # fmt: skip
    yield Section("Starting swivel", "Gain over DCAC for starts along the self-motion. From the start with the "
                  "largest mu, hardly any gain is possible.", [Table("Gain by start", columns(
                      "starts", "gain_at_maximum_percent", "gain_min_percent", "gain_mean_percent", "gain_max_percent"),
                      [summary["swivel"]])])  # fmt: skip
    keys = list(dict.fromkeys(key for row in summary["procedure"].values() for key in row))
    yield Section("The whole procedure", "A hand guides the tip to the incision, the camera finds the board, and the "
                  "task is done under MOC.", [
        Table("One procedure per task", [Column("task", "task"), *columns(*keys)],
              [{"task": task, **row} for task, row in summary["procedure"].items()]),
    ])  # fmt: skip


main = partial(command, "paper", "The paper's experiment, and which of its claims hold.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
