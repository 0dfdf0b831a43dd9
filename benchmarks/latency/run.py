"""Runs the parts of ``python -m benchmarks.speed`` one after the other, and gathers their numbers."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from benchmarks import baselines as peers
from benchmarks.common.timing import Timed, clock_cost_us, figures, interleaved, ratios
from benchmarks.latency import embedded, limit, setup, solve, tick
from benchmarks.latency import loop as speed_loop
from benchmarks.latency.bare import BARE
from benchmarks.latency.config import Config
from benchmarks.latency.goals import goal_verdicts
from benchmarks.solver_study.open_loop import expand
from moc_opt.embedded import NativeController
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.model.robot_model import load_robot
from moc_opt.numerics.arrays import Array
from moc_opt.scenario import Setup
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.solvers import available
from moc_opt.solvers.exact.solver import Exact

Advance = Callable[[str], None]
CHUNK = 100


class Run:
    """One measurement: ``measure`` gives the summary, ``rows`` and ``ticks`` what it was made from."""

    def __init__(self, config: Config) -> None:
        """Check the names before anything is measured.

        Raises:
            UnknownNameError: a solver, an adapter or a peer that does not exist.
        """
        self.config, self.rows, self.ticks = config, list[dict[str, Any]](), dict[str, Array]()
        self._missing: dict[str, str] = {}
        found = available()
        self._solvers = self._choose("solver", config.tick.solvers, found)
        self._adapters = self._choose("adapter", _all(config.adapters.names, BARE), {n: found.get(n, "") for n in BARE})
        self._peers = _all(config.peers.names, peers.PEERS)
        for name in self._peers:
            if name not in peers.PEERS:
                raise UnknownNameError("peer", name, peers.PEERS)
        scenario = config.scenario.change(seed=config.seed)
        self._scenario = speed_loop.bare(scenario.change(duration_s=config.loop.duration_s))
        self._robot = load_robot(scenario.robot.name)
        self._period = scenario.plant.period_s
        self._native: NativeController | None = None

    def steps(self) -> int:
        """Tell how often ``measure`` advances."""
        loop = self.config.loop
        return (
            7 + len(self._peers) + 3 * (1 + loop.runs) + 2 * loop.two_process_rounds
            + 2 * (1 + self.config.setup.processes)
        )  # fmt: skip

    def measure(self, advance: Advance) -> dict[str, Any]:
        """Measure everything: part -> name -> metric."""
        table = self.config.tick
        recording = tick.record(Setup(self._scenario.change(duration_s=table.ticks * self._period)))
        inputs, problems = recording.inputs, recording.problems
        expand(problems)
        advance("recorded a run")
        summary: dict[str, Any] = {"embedded": self._compile(inputs)}
        advance("compiled the tick to C")
        summary |= self._ticks(inputs, advance)
        summary["tick_parts"] = self._timed("tick_parts", self._parts(inputs), table.rounds, "tick")
        advance("parts of a tick")
        summary["exact"] = self._exact(problems)
        advance("exact")
        summary["adapters"] = self._compare(problems)
        advance("adapters")
        summary["beyond_the_library"] = self._beyond(summary)
        summary["loop"] = self._loop(advance, summary["embedded"].get("c", {}).get("own_p50_us"))
        summary["setup"], rows = setup.setup_times(self.config.setup.processes, advance)
        self.rows += rows
        summary["clock"] = {"cost": {"p50_us": clock_cost_us()}}
        summary["not_run"] = {name: {"reason": reason} for name, reason in self._missing.items()}
        summary["goals"] = goal_verdicts(summary)
        return summary

    def _choose(self, kind: str, names: list[str], found: Mapping[str, str | None]) -> list[str]:
        for name in names:
            if name not in found:
                raise UnknownNameError(kind, name, found)
        self._missing |= {f"{kind} {name}": str(found[name]) for name in names if found[name] is not None}
        return [name for name in names if found[name] is None]

    def _timed(self, part: str, entries: Mapping[str, Timed], rounds: int, prefix: str) -> dict[str, dict[str, float]]:
        """Time entries side by side; their times join the rows, their figures are returned: see `timing.figures`."""
        times = interleaved(entries, rounds, CHUNK)
        self._keep(part, times)
        self.ticks |= {name: found.ravel() for name, found in times.items()} if part == "tick" else {}
        return {name: figures(found, prefix) for name, found in times.items()}

    def _keep(self, part: str, times: Mapping[str, Array]) -> None:
        for name, chunks in times.items():
            late = np.percentile(chunks, [50, 99, 100], axis=1).T.tolist()
            self.rows += [
                {"part": part, "name": name, "round": i, "p50_us": p50, "p99_us": p99, "max_us": longest}
                for i, (p50, p99, longest) in enumerate(late)
            ]

    def _compile(self, inputs: list[Any]) -> dict[str, Any]:
        settings = self._scenario.control
        try:
            self._native = embedded.native(self._robot, settings, self._period)
            adapter = ControllerAdapter(Setup(self._scenario).controller())
            adapter.start(*inputs[0])
            found = {"difference_Nm": embedded.disagreement_Nm(self._native, adapter, inputs[:200])}
        except MocOptError as error:
            self._missing["tick in C"] = str(error)
            return {}
        try:
            found |= embedded.own_main(self._robot, settings, self._period, inputs[:500])
        except (MocOptError, OSError, subprocess.SubprocessError) as error:
            self._missing["exported C program"] = f"{type(error).__name__}: {error}"
        return {"c": found}

    def _ticks(self, inputs: list[Any], advance: Advance) -> dict[str, Any]:
        """Return our ticks and the peers' side by side."""
        own, refused = tick.own_ticks(self._solvers, self._robot, self._scenario.control, inputs, self._period)
        runs, absent = tick.peer_ticks(self._peers, self._robot, advance)
        self._missing |= {f"solver {k}": v for k, v in refused.items()} | {f"peer {k}": v for k, v in absent.items()}
        entries = dict(own)
        if self._native is not None:
            self._native.start(*inputs[0])
            entries["c"] = Timed(tick.spread(self._native.tick), inputs)
        entries |= {f"peer {name}": run.timed for name, run in runs.items()}
        shortest = min(len(entry.items) for entry in entries.values())
        rounds = max(self.config.tick.rounds, round(self.config.tick.rounds * len(inputs) / shortest))
        found = self._timed("tick", entries, rounds, "tick")
        advance("whole ticks")
        told = {
            name: {
                **found.pop(f"peer {name}"), "level": run.level,
                "installed": "make" if peers.PEERS[name].extra else "hand",
                **{key: value for key, value in run.verdict._asdict().items()},
            }
            for name, run in runs.items()
        }  # fmt: skip
        return {"tick": found, "peers": told}

    def _parts(self, inputs: list[Any]) -> dict[str, Timed]:
        solver = Setup(self._scenario).controller().solver
        assert solver is not None
        return tick.parts(self._robot, self._scenario.control, solver, inputs, self._period)

    def _exact(self, problems: list[Any]) -> dict[str, dict[str, float]]:
        table, rng = self.config.exact, np.random.default_rng(self.config.seed)
        by_name = {"recorded": problems}
        by_name |= {f"n = {n}": solve.random_problems(n, table.problems, rng) for n in table.joints}
        rows = {name: np.array([qp.row for qp in found]) for name, found in by_name.items()}
        entries = {name: Timed(Exact().start(found[0]).solve, found) for name, found in by_name.items()}
        shortest = min(map(len, by_name.values()))
        times = self._timed("exact", entries, max(2, self.config.tick.ticks // shortest), "solve")
        return {
            name: {
                **times[name], "kernel_us": solve.kernel_us(rows[name]),
                **solve.batch(rows[name], table.batch if name == "recorded" else max(1, table.batch // 10)),
                **solve.residuals(by_name[name]),
            }
            for name in by_name
        }  # fmt: skip

    def _compare(self, problems: list[Any]) -> dict[str, dict[str, float]]:
        pairs, refused = solve.adapters(self._adapters, self._robot, problems)
        self._missing |= {f"adapter {name}": reason for name, reason in refused.items()}
        found: dict[str, dict[str, float]] = {}
        entries = {f"{name} / {kind}": timed for name, kinds in pairs.items() for kind, timed in kinds.items()}
        if not entries:
            return found
        times = interleaved(entries, self.config.adapters.rounds, CHUNK)
        self._keep("adapters", times)
        for name in pairs:
            ours, hand, library = (times[f"{name} / {kind}"] for kind in ("adapter", "by hand", "library"))
            ratio = ratios(ours, hand)
            found[name] = {
                **figures(ours, "adapter"), "by_hand_p50_us": float(np.median(hand)),
                "library_p50_us": float(np.median(library)), "ratio": float(np.median(ratio)),
                "ratio_low": float(np.percentile(ratio, 25)), "ratio_high": float(np.percentile(ratio, 75)),
                "ratio_to_library": float(np.median(ratios(ours, library))),
            }  # fmt: skip
        return found

    def _beyond(self, summary: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Return what a tick costs beyond our own part and the library by hand."""
        ticks = {name: metrics["tick_p50_us"] for name, metrics in summary["tick"].items()}
        hand = {name: metrics["by_hand_p50_us"] for name, metrics in summary["adapters"].items()}
        rest = ticks["exact"] - summary["exact"]["recorded"]["solve_p50_us"]
        return {name: {"beyond_us": ticks[name] - rest - hand[name]} for name in hand if name in ticks}

    def _loop(self, advance: Advance, c_tick_us: float | None) -> dict[str, dict[str, float]]:
        table, whole = self.config.loop, self.config.scenario
        loops = {"python": self._scenario.change(control={"backend": "python"})}
        loops["judged"] = loops["python"].change(judge=whole.judge, bound_samples=whole.bound_samples)
        if self._native is not None:
            loops["c"] = self._scenario.change(control={"backend": "c"})
        steps, alone, plant = list[float](), list[float](), limit.Steps(self._scenario)

        def beside() -> None:
            steps.append(plant.us())
            alone.append(plant.alone_us())

        found, rows = speed_loop.factors(loops, table.runs, advance, beside)
        self.rows += rows
        found["limit"] = limit.ratios(rows, steps, alone, c_tick_us)
        if table.two_process_rounds:
            short = self._scenario.change(duration_s=min(4.0, table.duration_s))
            found["two processes"] = speed_loop.two_processes(short, 2 * table.runs, table.two_process_rounds, advance)
        found["memory"] = speed_loop.memory(self._scenario, *table.memory_s)
        advance("memory")
        return found


def _all(names: Any, everything: Mapping[str, Any]) -> list[str]:
    return list(everything) if names == "all" else list(names)
