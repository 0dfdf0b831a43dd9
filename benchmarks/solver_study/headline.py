"""The result of the study in words, computed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.solver_study.cells import RIGHTLY, answers_rightly, share_right
from benchmarks.solver_study.study import NONLINEAR
from moc_opt.figures.notation import Doubtful
from moc_opt.study.statistics import spread, too_few
from moc_opt.study.trials import BASELINE

Rows = Mapping[str, Mapping[str, Any]]

SIX_ROWS = "on the paper's six dependent rows, with the cost unscaled and the libraries' own defaults"


def headline(summary: Mapping[str, Rows], words: Mapping[str, str]) -> str:
    """Say the result in words.

    Args:
        summary: part -> solver or controller -> metric.
        words: verdicts of the parts; that on "prediction" is appended.
    """
    every = {n: m for n, m in summary.get("testsets", {}).items() if not n.startswith(NONLINEAR)}
    parts = [
        *_answers(every), *_growth(summary.get("growth", {})), *_closed_loop(summary.get("closed_loop", {})),
    ]  # fmt: skip
    text = ". ".join(part[0].upper() + part[1:] for part in parts) + "." if parts else "Nothing was run."
    return " ".join([text, *(words[key] for key in ("prediction",) if key in words)])


def _answers(every: Rows) -> Iterator[str]:
    """Yield what the answers to the certified sets are worth; `every` is "solver@setting" -> metric."""
    linear = _under("recommended", every)
    if linear:
        right = sum(share_right(m) == 1.0 for m in linear.values())
        text = f"{right} of {len(linear)} solvers answered every problem of the certified sets rightly"
        refused = [f"{n} ({m['refused_inconsistent']})" for n, m in linear.items() if m.get("refused_inconsistent")]
        if refused:
            text += f" or refused it as inconsistent (refused: {', '.join(refused)})"
        times = {n: m.get("solve_p50_us_worst_set") for n, m in linear.items() if answers_rightly(m)}
        timed = {n: us for n, us in times.items() if us is not None}
        if timed and not any(isinstance(us, Doubtful) for us in timed.values()):
            fastest = min(timed, key=timed.__getitem__)
            text += (
                f"; of those right at {100 * RIGHTLY:g} % or more the fastest is {fastest} "
                f"({100 * share_right(linear[fastest]):.1f} %) with a median of {timed[fastest]:.1f} us on its slowest "
                "set"
            )
        yield text
    for rows, settings in ((linear, "under our settings"), (_under("default", every), SIX_ROWS)):
        wrong = [f"{n} ({m['silently_wrong']})" for n, m in rows.items() if m["silently_wrong"]]
        if wrong:
            yield f"claimed success for wrong answers {settings} (how often): {', '.join(wrong)}"
    for key, said in (("hung", "never returned"), ("crashed", "took their process with them")):
        names = [n for n, m in every.items() if m[key]]
        if names:
            yield f"{said}: {', '.join(names)}"


def _under(setting: str, every: Rows) -> Rows:
    """Return solver -> metric under one setting."""
    return {n.partition("@")[0]: m for n, m in every.items() if n.endswith(f"@{setting}")}


def _growth(rows: Rows) -> Iterator[str]:
    """Yield how the median time changes with the joints."""
    ratios = {
        name: (value, key.rpartition("us_")[2].split("_over_"))
        for name, row in rows.items()
        for key, value in row.items()
        if key.startswith("solve_p50_us_") and "_over_" in key
    }
    if ratios:
        least, most = min(ratios, key=lambda n: ratios[n][0]), max(ratios, key=lambda n: ratios[n][0])
        last, first = ratios[most][1]
        yield (
            f"from {first} to {last} joints the median time changes by a factor of {ratios[least][0]:.1f} with "
            f"{least} and of {ratios[most][0]:.1f} with {most}"
        )


def _closed_loop(rows: Rows) -> Iterator[str]:
    """Yield what the solvers with the most trials do to manipulability; of too few trials nothing is said of it."""
    whole = {n: m for n, m in rows.items() if n != BASELINE and not m.get("short_runs")}  # of the same ticks
    trials = max((m.get("compared_trials", 0) for m in whole.values()), default=0)
    gains = {n: m["mu_gain_percent"] for n, m in whole.items() if trials and m["compared_trials"] == trials}
    if not gains:
        return
    if few := too_few(trials):
        yield f"the solvers' effect on manipulability in closed loop: {few}"
        return
    best, worst = max(gains, key=gains.__getitem__), min(gains, key=gains.__getitem__)
    yield (
        f"in closed loop, of the solvers with {trials} independent trials, mean manipulability changed by "
        f"{spread(rows[best], 'mu_gain_percent', sign='+')} % with {best} and by "
        f"{spread(rows[worst], 'mu_gain_percent', sign='+')} % with {worst}"
    )
