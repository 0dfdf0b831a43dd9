"""The parts of the study in open loop: the recorded sequence, the certified sets, more joints, duals."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.solver_study import compare, growth
from benchmarks.solver_study.answers import Limits, recorded
from benchmarks.solver_study.cells import (
    Cell,
    cold_only,
    costs_of,
    load,
    solved_duals,
    time_figures,
    totals,
)
from benchmarks.solver_study.settings import RECOMMENDED, SolverSetting, effective, in_words
from benchmarks.solver_study.study import NONLINEAR, Findings, Study
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.study.timing import Disturbance

DUAL_SETS = ("circle", "random")
DUAL_ROWS = {6: "duals on six rows", 5: "duals on five rows"}
GROWING = ("solve_p50_us", "solve_p99_us", "setup_p50_us", "update_p50_us")


def recorded_sequence(study: Study, so_far: Findings) -> Findings:
    """Ask every solver warm and cold for the recorded sequence, under the recommended settings; times one by one."""
    config, data = study.config, recorded("recorded", so_far.sequence)
    limits = Limits(max(2.0, config.testsets.patience_s), rounds=2, seconds=1.0, cold=config.open_loop.cold)
    thin = data.thinned(max(1, len(data.rows) // config.open_loop.cold))
    found, settings = Findings(), study.recommended
    parts = study.ask([(setting, data) for setting in settings], limits)
    answered = [Cell(setting, data, part) for setting, part in zip(settings, parts, strict=True)]
    taken = [cell for cell in answered if not cell.refused]
    found.summary["not_run"] = {cell.setting.solver: {"reason": cell.refused} for cell in answered if cell.refused}
    apart = study.ask([(cell.setting, thin) for cell in taken], limits, warm=False)
    measured = study.time(taken, limits)
    warm, cold, samples = {}, {}, {}
    for cell, part, times in zip(taken, apart, measured, strict=True):
        solver, alone = cell.setting.solver, Cell(cell.setting, thin, part)
        warm[solver], cold[solver] = cell.summary(times), alone.summary(cold_only(times))
        found.rows += cell.rows("open_loop_warm") + alone.rows("open_loop_cold")
        samples[solver] = times.arrays["solve_us"].ravel()
    found.summary |= {"open_loop_warm": warm, "open_loop_cold": cold}
    found.samples["open_loop"] = samples
    return found


def certified_sets(study: Study, so_far: Findings) -> Findings:
    """Ask every solver under every setting for every set; the answers several at a time, the times one by one."""
    table = study.config.testsets
    chosen = [load(name, table.every) for name in table.chosen()]
    thinned = [data.thinned(table.every_other) for data in chosen]
    limits = table.limits()
    first = study.recommended
    order = [*first, *(setting for setting in study.settings if setting not in first)]
    asked = [(setting, data) for setting in order for data in (chosen if _fully(setting) else thinned)]
    cells = [Cell(*question, part) for question, part in zip(asked, study.ask(asked, limits), strict=True)]
    by_setting = {s.label: [cell for cell in cells if cell.setting == s] for s in order}
    study.show({"testsets": {label: totals(mine, {}) for label, mine in by_setting.items()}})
    to_time = [
        cell for cell in cells
        if not cell.refused and cell.data.name in table.times(cell.setting.name == RECOMMENDED)
    ]  # fmt: skip
    times = {
        (cell.setting.label, cell.data.name): part
        for cell, part in zip(to_time, study.time(to_time, limits), strict=True)
    }
    found, whole, costs = Findings(), {}, {}
    for setting in order:
        mine = by_setting[setting.label]
        measured = {name: part for (label, name), part in times.items() if label == setting.label}
        for cell in mine:
            part = found.summary.setdefault(f"testset {cell.data.name}", {})
            part[setting.label] = cell.summary(measured.get(cell.data.name))
            found.rows += cell.rows("testset")
        whole[setting.label] = totals(mine, measured)
        if setting.name == RECOMMENDED and len(mine[0].data.rows) == len(chosen[0].rows):
            costs[setting.solver] = costs_of(mine, measured)
    found.summary["testsets"] = whole
    found.summary["settings"] = {
        s.label: {"options": in_words(effective(s)), "reason": s.reason} for s in study.settings
    }
    found.samples["profile"] = costs
    return found


def _fully(setting: SolverSetting) -> bool:
    return setting.name == RECOMMENDED and not setting.solver.startswith(NONLINEAR)


def more_joints(study: Study, so_far: Findings) -> Findings:
    """Measure how times grow with the joints, under the recommended settings."""
    limits = study.config.testsets.limits()
    sets = {n: growth.sequence(n) for n in study.config.growth.joints}
    asked = [(setting, data) for setting in study.growing for data in sets.values()]
    cells = [Cell(*question, part) for question, part in zip(asked, study.ask(asked, limits), strict=True)]
    taken = [cell for cell in cells if not cell.refused]
    times = {
        (cell.setting.solver, cell.data.n): time_figures(part)
        for cell, part in zip(taken, study.time(taken, limits), strict=True)
    }
    found: dict[str, dict[str, Any]] = {}
    for setting in study.growing:
        row: dict[str, Any] = {"verified_solved": 0, "solves": 0}
        figures: dict[int, dict[str, Any]] = {}
        for cell in (cell for cell in cells if cell.setting == setting):
            if cell.refused:
                row["reason"] = cell.refused
                continue
            n = cell.data.n
            figures[n], counts = times[setting.solver, n], cell.counts()
            row |= {key: row[key] + counts[key] for key in ("verified_solved", "solves")}
            row |= {f"{key}_n{n}": figures[n][key] for key in GROWING if key in figures[n]}
        row |= Disturbance.total(figures.values()).entries()
        for key in GROWING:
            row |= {f"{key}_{name}": value for name, value in growth.growth(figures, key).items()}
        found[setting.solver] = row
    return Findings({"growth": found})


def duals(study: Study, so_far: Findings) -> Findings:
    """Measure how far apart any two solvers' multipliers are on the same problems with six rows and with five."""
    config = study.config
    sets = [load(name, max(2, config.testsets.every)) for name in DUAL_SETS]
    settings = {
        (name, rows): SolverSetting(name, f"rows={rows}", {**config.settings.get(name, {}), "rows": rows}, "")
        for name in study.with_duals for rows in DUAL_ROWS
    }  # fmt: skip
    asked = [(setting, data) for setting in settings.values() for data in sets]
    parts = iter(study.ask(asked, config.testsets.limits()))
    given = {which: np.concatenate([solved_duals(next(parts)) for _ in sets]) for which in settings}
    problems = [NullSpaceQP.from_row(np.array(row)) for data in sets for row in data.rows]
    summary = {
        part: compare.dual_distances(problems, {name: given[name, rows] for name in study.with_duals})
        for rows, part in DUAL_ROWS.items()
    }
    return Findings(summary, words={"duals": compare.dual_verdict(*summary.values())})
