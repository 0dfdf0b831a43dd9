"""The columns of the study's tables."""

from __future__ import annotations

from typing import Any

from moc_opt.report.tables import Column

SOLVER = Column("solver", "solver")
RANKED = "answers_rightly"  # flag of the rows whose times are compared
AS_MANY = "as_many_trials"  # flag of the rows whose means are compared: those over all the trials


def count(key: str, title: str, better: Any = None, text: str = "") -> Column:
    """Make a column of counts."""
    return Column(key, title, format=".0f", better=better, help=text)


def residual(key: str, title: str, text: str = "", better: Any = "low") -> Column:
    """Make a column of residuals, as powers of ten."""
    return Column(key, title, format=".1e", better=better, help=text)


def time(key: str, title: str, text: str = "") -> Column:
    """Make a column of times [us]; the best is marked among the solvers that answer rightly."""
    return Column(key, title, unit="us", format=".1f", better="low", help=text, among=RANKED)


def times(suffix: str = "") -> list[Column]:
    """Warm, cold and setting up."""
    return [
        time(f"solve_p50_us{suffix}", "warm p50"),
        time(f"solve_p99_us{suffix}", "warm p99"),
        time(f"solve_p99_9_us{suffix}", "warm p99.9"),
        time(f"update_p50_us{suffix}", "update p50", "of a warm solve, the part that updates the library's problem"),
        time(f"cold_p50_us{suffix}", "cold p50"),
        time(f"cold_p99_us{suffix}", "cold p99"),
        time(f"setup_p50_us{suffix}", "set-up p50"),
    ]


def error(key: str, title: str) -> Column:
    """Make a column of errors [mm]."""
    return Column(key, title, unit="mm", digits=3, better="low", among=AS_MANY)


def change(key: str, title: str) -> Column:
    """Make a column of changes against DCAC, texts with their intervals."""
    return Column(key, title, unit="%", help="against DCAC's mean on the same trials, with its 95 % interval")


COUNTS = [
    Column(
        "right_percent", "right", unit="%", format=".1f", better="high",
        help="optima verified and infeasible problems called so, among all but the refused ones",
    ),
    count("claimed_solved", "claimed", text="answers that the solver calls solved"),
    count("verified_solved", "verified", text="of these, optimal by our residuals"),
    count("silently_wrong", "silently wrong", "low", "claimed, but not optimal"),
    count("infeasible_right", "infeas. right", text="called infeasible, and certified so"),
    count("refused_inconsistent", "refused: inconsistent", text="called infeasible: the six rows given do contradict"),
    count("infeasible_wrong", "infeas. wrong", "low", "called infeasible, and certified feasible"),
    count("failed", "failed", "low", "neither claimed nor rightly called infeasible"),
    count("hung", "hung", "low", "no answer within the time limit"),
    count("crashed", "crashed", "low", "the process died"),
    count("not_asked", "not asked", text="after two hangs in the set or hangs in three sets, or not supported"),
]  # fmt: skip
RESIDUALS = [
    residual("primal_max", "primal", "largest |A x - b| or box violation of all answers given, claimed or not"),
    residual("natural_max", "natural", "largest natural residual with the solver's own duals", None),
    residual("relative_max", "relative", "the same, best duals, cost scaled to one"),
    residual("loss_max", "loss", "self-motion loss: 0 optimum, 1 opposite end"),
]
CLOSED = [
    count("runs", "trials", text="each with a seed of its own; the first ones of those of the others"),
    count("ticks", "ticks", text="of all its trials; slow solvers run the beginning of each alone"),
    Column("mu_mean", "mu", format=".4f", better="high", among=AS_MANY),
    Column("mu_fraction_of_bound", "of bound", better="high", among=AS_MANY,
           help="of the largest mu on the self-motion"),
    Column("mu_fraction_of_best_from_start", "of best from start", better="high", among=AS_MANY,
           help="of the best course from there"),
    Column("mu_fraction_of_best", "of best", better="high", among=AS_MANY,
           help="of the best course from any swivel and branch"),
    change("mu_gain_interval", "gain"),
    error("tip_error_model_mean_mm", "tip"),
    change("tip_change_interval", "change of tip"),
    error("tip_error_registered_mean_mm", "tip, patient"),
    change("tip_patient_change_interval", "change of tip, patient"),
    error("rcm_error_model_mean_mm", "RCM"),
    change("rcm_change_interval", "change of RCM"),
    error("rcm_error_registered_mean_mm", "RCM, patient"),
    change("rcm_patient_change_interval", "change of RCM, patient"),
    error("tip_error_model_max_mm", "tip max"),
    error("rcm_error_model_max_mm", "RCM max"),
    error("rcm_error_mean_mm", "RCM, true trocar"),
    Column("travelling_percent", "transient", unit="%", digits=2, help="of the time the elbow is on its way"),
    Column("trocar_force_mean_N", "force", unit="N", digits=2, better="low", among=AS_MANY),
    Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", format=".0f", better="low", among=AS_MANY),
]
STEADY_STATE = [
    error("tip_error_model_settled_mean_mm", "tip, steady"),
    error("rcm_error_model_settled_mean_mm", "RCM, steady"),
    count("settled_ticks", "steady ticks", text="of all trials, the same for all controllers"),
]
CLAIMS = [
    count("claimed_solved", "claimed"), count("verified_solved", "verified"),
    count("silently_wrong", "silently wrong", "low"),
]  # fmt: skip
BROKEN = [count("broke_off", "broke off", "low"), count("oscillated", "oscillated", "low")]
TICKS = [
    count("deadline_misses", "misses", "low", "ticks longer than the deadline"),
    *(Column(f"tick_{p}_us", f"tick {p.replace('_', '.')}", unit="us", format=".1f", better="low")
      for p in ("p50", "p99", "p99_9")),
    *BROKEN,
]  # fmt: skip
SWEPT = [
    Column("infeasible_percent", "infeasible", unit="% of ticks", digits=3),
    Column("late_percent", "late", unit="% of ticks", digits=3),
    residual("primal_max", "primal max", better=None), residual("loss_max", "loss max", better=None), *BROKEN,
]  # fmt: skip
DUALS = [
    Column("solver", "pair"), Column("p50", "distance p50", digits=2, help="over the size of the cost"),
    Column("max", "distance max", digits=2), Column("along_p50", "along the free direction, p50", digits=2),
    Column("across_p50", "across it, p50", digits=2), Column("across_max", "across it, max", digits=2),
    count("problems", "problems"),
]  # fmt: skip
QPBENCHMARK = [
    SOLVER, count("rank", "their rank"), Column("success_percent", "success", unit="%", format=".0f", better="high"),
    Column("shgeom_us", "their mean", unit="us", digits=4, better="low", help="shifted geometric mean, shift 10 s"),
    Column("runtime_p50_us", "their p50", unit="us", format=".1f", better="low"),
    count("our_rank", "our rank"), Column("our_p50_us", "our p50", unit="us", format=".1f"),
    Column("our_right_percent", "right by us", unit="%", format=".1f", better="high"),
]  # fmt: skip
