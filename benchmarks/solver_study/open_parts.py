"""The parts of the study in open loop: the recorded sequence, the certified sets, more joints, duals."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.common.crew import spread
from benchmarks.common.processes import Worker
from benchmarks.solver_study import compare, growth
from benchmarks.solver_study.answers import Limits, asked, recorded, timed
from benchmarks.solver_study.cells import (
    Cell,
    asked_all,
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

DUAL_SETS = ("circle", "random")
DUAL_ROWS = {6: "duals on six rows", 5: "duals on five rows"}
GROWING = ("solve_p50_us", "solve_p99_us", "setup_p50_us", "update_p50_us")


def recorded_sequence(study: Study, so_far: Findings) -> Findings:
    """Ask every solver warm and cold for the recorded sequence, under the recommended settings; times one by one."""
    config, data = study.config, recorded("recorded", so_far.sequence)
    limits = Limits(max(2.0, config.testsets.patience_s), rounds=2, seconds=1.0, cold=config.open_loop.cold)
    thin = data.thinned(max(1, len(data.rows) // config.open_loop.cold))
    found = Findings()
    warm, cold, samples = {}, {}, {}

    def both(worker: Worker, setting: SolverSetting) -> tuple[Cell, Cell | None]:
        cell = Cell(setting, data, asked(study.store, worker, setting, data, limits))
        part = None if cell.refused else asked(study.store, worker, setting, thin, limits, warm=False)
        study.advance(f"open loop {setting.solver}, answers")
        return cell, part and Cell(setting, thin, part)

    answered = spread(study.recommended, both, config.processes)
    with Worker() as worker:
        for setting, (cell, apart) in zip(study.recommended, answered, strict=True):
            solver = setting.solver
            study.advance(f"open loop {solver}")
            if apart is None:
                found.summary.setdefault("not_run", {})[solver] = {"reason": cell.refused}
                continue
            times = timed(study.store, worker, setting, data, limits, cell.complete)
            warm[solver], cold[solver] = cell.summary(times), apart.summary(cold_only(times))
            found.rows += cell.rows("open_loop_warm") + apart.rows("open_loop_cold")
            samples[solver] = times.arrays["solve_us"].ravel()
            study.show({"open_loop_warm": dict(warm)})
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
    early: dict[str, Any] = {}

    def all_sets(worker: Worker, setting: SolverSetting) -> list[Cell]:
        fully = setting.name == RECOMMENDED and not setting.solver.startswith(NONLINEAR)
        cells = asked_all(study.store, worker, setting, chosen if fully else thinned, limits)
        early[setting.label] = totals(cells, {})
        study.show({"testsets": dict(early)})
        study.advance(f"answers {setting.label}")
        return cells

    answered = spread(order, all_sets, study.config.processes)
    found, whole, costs = Findings(), {}, {}
    with Worker() as worker:
        for setting, cells in zip(order, answered, strict=True):
            recommended = setting.name == RECOMMENDED
            measured = {
                cell.data.name: timed(study.store, worker, setting, cell.data, limits, cell.complete)
                for cell in cells
                if not cell.refused and cell.data.name in table.times(recommended)
            }
            for cell in cells:
                part = found.summary.setdefault(f"testset {cell.data.name}", {})
                part[setting.label] = cell.summary(measured.get(cell.data.name))
                found.rows += cell.rows("testset")
            whole[setting.label] = totals(cells, measured)
            if recommended and len(cells[0].data.rows) == len(chosen[0].rows):
                costs[setting.solver] = costs_of(cells, measured)
            study.advance(f"times {setting.label}")
    found.summary["testsets"] = whole
    found.summary["settings"] = {
        s.label: {"options": in_words(effective(s)), "reason": s.reason} for s in study.settings
    }
    found.samples["profile"] = costs
    return found


def more_joints(study: Study, so_far: Findings) -> Findings:
    """Measure how times grow with the joints, under the recommended settings."""
    limits = study.config.testsets.limits()
    sets = {n: growth.sequence(n) for n in study.config.growth.joints}
    found: dict[str, dict[str, Any]] = {}

    def all_sets(worker: Worker, setting: SolverSetting) -> dict[int, Cell]:
        return {n: Cell(setting, data, asked(study.store, worker, setting, data, limits)) for n, data in sets.items()}

    answered = spread(study.growing, all_sets, study.config.processes) if study.growing else []
    with Worker() as worker:
        for setting, cells in zip(study.growing, answered, strict=True):
            figures: dict[int, dict[str, Any]] = {}
            row: dict[str, Any] = {"verified_solved": 0, "solves": 0}
            for n, cell in cells.items():
                if cell.refused:
                    row["reason"] = cell.refused
                    continue
                figures[n] = time_figures(timed(study.store, worker, setting, cell.data, limits, cell.complete))
                counts = cell.counts()
                row |= {key: row[key] + counts[key] for key in ("verified_solved", "solves")}
                row |= {f"{key}_n{n}": figures[n][key] for key in GROWING if key in figures[n]}
            for key in GROWING:
                row |= {f"{key}_{name}": value for name, value in growth.growth(figures, key).items()}
            found[setting.solver] = row
            study.advance(f"joints {setting.solver}")
    return Findings({"growth": found})


def duals(study: Study, so_far: Findings) -> Findings:
    """Measure how far apart any two solvers' multipliers are on the same problems with six rows and with five."""
    config = study.config
    limits = config.testsets.limits()
    sets = [load(name, max(2, config.testsets.every)) for name in DUAL_SETS]

    def both(worker: Worker, name: str) -> dict[int, Any]:
        mine = {}
        for rows in DUAL_ROWS:
            setting = SolverSetting(name, f"rows={rows}", {**config.settings.get(name, {}), "rows": rows}, "")
            parts = [asked(study.store, worker, setting, data, limits) for data in sets]
            mine[rows] = np.concatenate([solved_duals(part) for part in parts])
        study.advance(f"duals {name}")
        return mine

    names = study.with_duals
    given = dict(zip(names, spread(names, both, config.processes) if names else [], strict=True))
    problems = [NullSpaceQP.from_row(np.array(row)) for data in sets for row in data.rows]
    summary = {
        part: compare.dual_distances(problems, {name: mine[rows] for name, mine in given.items()})
        for rows, part in DUAL_ROWS.items()
    }
    return Findings(summary, words={"duals": compare.dual_verdict(*summary.values())})
