"""How long do ticks, solvers, the closed loop and other libraries take?

python -m benchmarks.speed [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

Times of different runs cannot be compared. An *adapter* passes our problems to another library's solver. A *peer* is a
controller made with another robotics library.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, Literal, Self

from numpy.typing import ArrayLike
from pydantic import Field, field_validator

from benchmarks import peers, timed
from benchmarks.goals import Goal, goals_sentence, goals_table, judge
from moc_opt.errors import UnknownNameError
from moc_opt.figures import latency_ecdf
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job
from moc_opt.study.command import Found, Study, StudyConfig, choose, command
from moc_opt.study.results import Results
from moc_opt.study.show import Picture, Report, Section, about
from moc_opt.study.timing import clock_cost_us, load, total

Count = Annotated[int, Field(ge=1)]
Names = Literal["all"] | list[str]
Summary = Mapping[str, Any]
TICKS, PEERS, SOLVERS, LOOP = "Ticks", "Other libraries", "Solvers", "Loop"
TIMED = ("tick", "tick_parts", "peers", "adapters", "loop")
"""parts of the summary whose entries also tell the machine's load"""


class Config(StudyConfig):
    solvers: list[str] = Field(["exact", "daqp", "proxqp", "osqp"])
    ticks: int = Field(2000, ge=100)
    rounds: Count = 4
    batch: Count = 1_000_000
    adapters: Names = "all"
    runs: Count = 5
    starts: Count = Field(5, description="how often the first torque and `moc-opt run` are timed, in new processes")
    peers: Names = "all"
    scenario: Scenario = Scenario()

    @field_validator("solvers")
    @classmethod
    def _with_exact(cls, value: list[str]) -> list[str]:
        if "exact" not in value:
            raise ValueError("'exact' must be among them, because all others are compared with it")
        return value

    def quick(self) -> Self:
        few = {
            "ticks": min(self.ticks, 400), "rounds": 1, "batch": min(self.batch, 20_000), "runs": 1, "starts": 1,
            "scenario": self.scenario.change(duration_s=1.0),
        }  # fmt: skip
        return self.model_copy(update=few)


def work(study: Study, config: Config) -> Found:
    solvers, no_solver = choose(config.solvers)
    adapters, no_adapter = choose(timed.ADAPTERS if config.adapters == "all" else config.adapters)
    libraries = list(peers.PEERS) if config.peers == "all" else config.peers
    if unknown := [name for name in libraries if name not in peers.PEERS]:
        raise UnknownNameError("peer", unknown[0], peers.PEERS)
    no_peer = {name: reason for name in libraries if (reason := peers.missing(name))}
    tried = [name for name in libraries if name not in no_peer]
    checks = [Job(peers.check, (name,), limit_s=60.0) for name in tried]
    for name, failure in zip(tried, _measured(study, checks, "other libraries"), strict=True):
        if failure is not None:
            no_peer[name] = str(failure)
    able = [name for name in tried if name not in no_peer]

    # Judging answers and bounding mu are not part of the loop's time.
    scenario, rounds = config.scenario.change(seed=config.seed, judge=False, bound_samples=0), config.rounds
    long = scenario.change(duration_s=config.ticks * scenario.plant.period_s)
    asked: dict[str, tuple[Callable[..., timed.Part], tuple[Any, ...]]] = {
        "ticks": (timed.ticks, (long, solvers, able, rounds)), "parts of a tick": (timed.tick_parts, (long, rounds)),
        "moc_step in C": (timed.exported, (scenario.change(duration_s=1.0),)),
        "batch": (timed.batch, (long, config.batch)), "adapters": (timed.adapters, (long, adapters, rounds)),
        "loop": (timed.loop, (scenario, config.runs)), "new processes": (timed.fresh, (config.starts,)),
    }  # fmt: skip
    jobs = [Job(call, given, limit_s=1800.0, alone=True, group=name) for name, (call, given) in asked.items()]
    whole, failed = timed.Part(), dict[str, str]()
    for name, part in zip(asked, _measured(study, jobs, "times"), strict=True):
        if isinstance(part, Failed):
            failed[name] = str(part)
            continue
        for key, found in part.found.items():
            whole.found[key] = {**whole.found.get(key, {}), **found}
        whole.rows += part.rows
        failed |= part.missing
        if name == "ticks":
            whole.times = {entry: times.ravel() for entry, times in part.times.items()}
    for kind, reasons in (("solver", no_solver), ("adapter", no_adapter), ("peer", no_peer)):
        failed |= {f"{kind} {name}": reason for name, reason in reasons.items()}
    summary = summed_up(whole, failed)
    rows = Results([*whole.rows, *({"controller": name, "error": reason} for name, reason in failed.items())])
    seen = {"load": total(timed_rows(summary))}
    return Found(report(summary, whole.times, about(scenario)), summary, rows, seen)


def _measured(study: Study, jobs: Sequence[Job], what: str) -> list[Any]:
    return study.run(jobs, what, keep=lambda result: False)


def summed_up(whole: timed.Part, failed: Mapping[str, str]) -> dict[str, Any]:
    summary: dict[str, Any] = {name: {} for name in (*TIMED, "batch", "setup")} | whole.found
    if loop := summary["loop"]:
        rounds = [row for row in whole.rows if row["part"] == "loop"]
        c_tick = summary["tick"].get("c", {}).get("tick_mean_us")
        loop["limit"] = timed.limit(rounds, c_tick)
    summary["clock"] = {"cost": {"p50_us": clock_cost_us()}}
    summary["not_run"] = {name: {"reason": reason} for name, reason in failed.items()}
    return summary | {"goals": judge(summary, GOALS)}


# --- goals ---


def _batch(s: Any) -> float | None:
    found = s["batch"]["exact"]
    # In a smaller batch, starting the threads takes most of the time.
    return found["batch_two_threads_per_s"] / 1e6 if found["batch"] >= 1_000_000 else None


GOALS = {
    "first_torque": Goal(
        "new process: time from import to first torque", "s", 0.5, lambda s: s["setup"]["first_tick_s"],
        made_of=lambda s: "libraries {libraries_s:.2f}, model {model_s:.2f}, start and tick {start_and_tick_s:.2f} s"
        .format(**s["setup"]),
    ),
    "first_run": Goal("new process: time of `moc-opt run`", "s", 10.0, lambda s: s["setup"]["first_run_s"]),
    "exact": Goal(
        "solve time: exact from Python / daqp called directly", "", 0.12,
        lambda s: s["adapters"][timed.BY_HAND]["ratio_of_exact"], section=SOLVERS,
        made_of=lambda s: f"{s['adapters']['exact']['adapter_p50_us']:.2f} / "
        f"{s['adapters'][timed.BY_HAND]['adapter_p50_us']:.2f} us",
    ),
    "batch": Goal(
        "rate of exact in a batch on two threads", "million/s", 4.0, _batch, most=False, section=SOLVERS,
        made_of=lambda s: f"on one thread {s['batch']['exact']['batch_one_thread_per_s'] / 1e6:.2f} million/s",
    ),
    "tick": Goal(
        "tick time: pink-trimmed / ours with exact", "", 12.0, lambda s: s["peers"]["pink-trimmed"]["times_ours"],
        most=False, section=PEERS, made_of=lambda s: f"{s['peers']['pink-trimmed']['tick_p50_us']:.0f} / "
        f"{s['tick']['exact']['tick_p50_us']:.1f} us",
    ),
    "c_tick": Goal(
        "mean time of moc_step in C", "us", 4.0, lambda s: s["tick"]["c"]["tick_mean_us"], section=TICKS,
        made_of=lambda s: f"longest {s['tick']['c']['tick_max_us']:.1f} us",
    ),
    "limit": Goal(
        "time of the default run / shortest possible time (MuJoCo's steps plus moc_step)", "", 3.0,
        lambda s: s["loop"]["limit"]["python_over_limit"], section=LOOP,
        made_of=lambda s: f"{s['loop']['python']['us_per_tick']:.1f} us per tick, of which filter and controller take "
        f"{s['loop']['python']['tick_p50_us']:.1f} us; shortest: MuJoCo {s['loop']['limit']['steps_us']:.1f} us plus C "
        f"{s['tick']['c']['tick_mean_us']:.1f} us",
    ),
}  # fmt: skip


# --- report ---


def _times(of: str, *percentiles: str, form: str = ".1f") -> list[Column]:
    return [Column(f"{of}_{p}_us", p.replace("_", "."), unit="us", format=form, better="low") for p in percentiles]


COLUMNS = {
    "tick": ("One tick, from state to torque", [
        Column("name", "tick with"), *_times("tick", "p50", "p99", "p99_9"),
        Column("tick_cold_p50_us", "cold", unit="us", format=".1f", better="low",
               help="median over the first five calls of each chunk"),
        Column("tick_mean_us", "mean", unit="us", format=".1f",
               help="mean time of a tick; for `c`, there are no percentiles"),
        Column("tick_max_us", "longest", unit="us", format=".1f", better="low"),
    ]),
    "tick_parts": ("Parts of a tick with exact", [
        Column("name", "part"), *_times("tick", "p50", "p99", form=".2f"),
    ]),
    "peers": ("One tick in other libraries, for the same job on the same arm", [
        Column("name", "controller"), Column("level", "output", help="a velocity still needs a servo"),
        *_times("tick", "p50", "p99"),
        Column("times_ours", "this / ours", format=".2f", help="ratio of tick times, median over the chunks"),
        Column("tip_error_max_mm", "tip", unit="mm", help="largest tip error on an ideal arm from t = 0.5 s on"),
        Column("rcm_error_max_mm", "shaft", unit="mm", help="largest shaft error in the same interval"),
        Column("mu_rise_percent", "mu", unit="%", format="+.1f", help="rise of mu over the run of one second"),
    ]),
    "adapters": ("Solvers from Python", [
        Column("name", "adapter"), *_times("adapter", "p50", "p99", form=".2f"),
        Column("ratio_of_exact", "exact / this", format=".3f", help="ratio of solve times, median over the chunks"),
    ]),
    "loop": ("The closed loop", [
        Column("name", "loop"), Column("factor", "real time", unit="times", format=".1f", better="high"),
        Column("us_per_tick", "run per tick", unit="us", format=".1f", help="time of the run / number of its ticks"),
        *_times("tick", "p50", "p99", "p99_9"),
    ]),
}  # fmt: skip
SECTIONS = {
    TICKS: (
        ("tick", "tick_parts"),
        "The inputs of the ticks are recorded in a run with the realistic plant. They are replayed in chunks of 100, "
        "and the controllers take turns chunk by chunk. The first round is not counted. Each part of a tick is timed "
        "alone, so the times do not add up exactly. `c` is `moc_step` in the exported program, with the safety filter.",
    ),
    PEERS: (
        ("peers",),
        "Each library is timed on the states of its own run on an ideal arm. It controls tip and shaft, limits the "
        "joint speeds, and follows the gradient of mu. `pink-trimmed` is pink with our compiled gradient and five "
        "equality constraints. A tick of moc_opt is timed on states of a run with the realistic plant.",
    ),
    SOLVERS: (
        ("adapters",),
        "`daqp by hand` calls daqp directly, with the adapter's settings and arrays. It is set up once. Each solve "
        "fills the arrays with a problem, and reads x and the multipliers.",
    ),
    LOOP: (
        ("loop",),
        "A run includes references, plant, controller, trace and the progress bar's callback, but not the set-up and "
        "the judging of answers. The shortest possible time is `moc_step` plus MuJoCo's steps from the same states. "
        "Real time: simulated time / time of the run.",
    ),
}  # fmt: skip


def report(summary: Summary, times: Mapping[str, ArrayLike], subject: str = "") -> Report:
    rows = {key: [{"name": name, **row} for name, row in summary[key].items()] for key in COLUMNS}
    if own := summary["tick"].get("exact"):
        rows["peers"].insert(0, {"name": "moc_opt", "level": "torque", "times_ours": 1.0, **own})
    rows["loop"] = [row for row in rows["loop"] if "factor" in row]
    tables = {key: Table(title, columns, rows[key]) for key, (title, columns) in COLUMNS.items() if rows[key]}
    sections = [
        Section(title, text, shown) for title, (keys, text) in SECTIONS.items()
        if (shown := [tables[key] for key in keys if key in tables])
    ]  # fmt: skip
    says = "Time of a tick. The further left a curve, the faster the controller; the steeper, the less it varies."
    pictures = [Picture(latency_ecdf(times), says, "ticks")] if times else []
    first = goals_table(summary["goals"])
    return Report("What everything costs", sentences(summary), first, pictures, sections,
                  load(timed_rows(summary)), subject)


def sentences(summary: Summary) -> list[str]:
    said = []
    if "exact" in summary["tick"] and "python" in summary["loop"]:
        own, factor = summary["tick"]["exact"]["tick_p50_us"], summary["loop"]["python"]["factor"]
        said.append(f"A tick with `exact` takes {own:.1f} us. The loop runs {factor:.0f} times faster than real time.")
    if summary["peers"]:
        name = min(summary["peers"], key=lambda peer: float(summary["peers"][peer]["times_ours"]))
        fastest = summary["peers"][name]
        said.append(
            f"The fastest other library, {name}, takes {fastest['tick_p50_us']:.1f} us for the same job, "
            f"{fastest['times_ours']:.2g} times our time."
        )
    return [*said, goals_sentence(summary["goals"])]


def timed_rows(summary: Summary) -> list[Mapping[str, Any]]:
    return [row for part in TIMED for row in summary[part].values()]


main = partial(command, "speed", "Measure what everything costs.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
