"""What a run is, as a validated table, and how it is put together: the only place that knows every room."""

from __future__ import annotations

import itertools
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator, model_validator

from moc_opt import solvers
from moc_opt.control import Controller, ControlSettings
from moc_opt.control.guard import Guard, GuardSettings
from moc_opt.errors import MocOptError, RobotError, ScenarioError, UnknownNameError
from moc_opt.model import RobotModel, load_robot
from moc_opt.selfmotion import self_motion
from moc_opt.settings import Settings
from moc_opt.sim.faults import Faults, FaultSettings
from moc_opt.sim.loop import Brain, RunAway, Stop, simulate
from moc_opt.sim.plant import Plant
from moc_opt.sim.settings import PlantSettings
from moc_opt.solvers.base import Solver, Status
from moc_opt.solvers.faulty import Faulty, draw
from moc_opt.solvers.registry import accepts
from moc_opt.subproblem import judge, row_length
from moc_opt.tasks import Reference, Trocar, make_path
from moc_opt.trace import Trace

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

MOST_TICKS = 5_000_000
"""Of a run: almost three hours at 500 Hz. More is a slip of the pen, and would not fit into memory."""


class RobotTable(Settings):
    """Which arm, and which tool on it."""

    KIND: ClassVar[str] = "[robot]"
    name: str = Field(default="lwr4", description="a robot of the package, or a path to a URDF or TOML")
    tool_length_m: float | None = Field(default=None, gt=0.0, le=10.0)
    tool_mass_kg: float | None = Field(default=None, gt=0.0, le=1000.0)


class StartTable(Settings):
    """The pose of the arm at t = 0; tip and wrist are those of q whatever the swivel."""

    KIND: ClassVar[str] = "[start]"
    q_rad: tuple[float, ...] | None = Field(default=None, description="None: the robot's home pose")
    swivel: float | Literal["given", "random"] = Field(
        default="given",
        description="place on the feasible self-motion, 0 to 1; 'given' leaves q; 'random' is drawn by the seed",
    )

    @field_validator("swivel")
    @classmethod
    def _a_fraction(cls, value: float | str) -> float | str:
        if isinstance(value, float) and not 0.0 <= value <= 1.0:
            raise ValueError("a swivel is a fraction from 0 to 1")
        return value


class TrocarTable(Settings):
    """Where the shaft enters: a point on it at t = 0, then fixed or breathing."""

    KIND: ClassVar[str] = "[trocar]"
    depth_m: float = Field(default=0.15, gt=0.0, description="of the tip below the trocar at t = 0")
    breathing_amplitude_m: float = Field(default=0.0, ge=0.0, le=0.5)
    breathing_period_s: float = Field(default=4.0, gt=0.0)
    breathing_direction: Vector = (0.0, 0.0, 1.0)
    breathing_known: bool = Field(
        default=True, description="whether the registered trocar follows the breathing"
    )


class TaskTable(Settings):
    """The path of the tip."""

    KIND: ClassVar[str] = "[task]"
    path: str = "circle"
    sizes: dict[str, float] = Field(default_factory=dict, description="of the path [m]; see moc_opt.tasks")
    normal: Vector = (0.0, 0.0, 1.0)
    heading: Vector = (1.0, 0.0, 0.0)
    v_max_m_per_s: float = Field(default=0.05, gt=0.0)
    a_max_m_per_s2: float = Field(default=0.2, gt=0.0)
    wait_s: float = Field(default=0.5, ge=0.0, description="rest before the path")
    hold_s: float = Field(default=0.5, ge=0.0, description="rest after it")

    DEFAULT_SIZES: ClassVar[dict[str, dict[str, float]]] = {
        "line": {"length": 0.04},
        "circle": {"radius": 0.03},
        "sinusoid": {"amplitude": 0.01, "wavelength": 0.02, "periods": 2.0},
        "spiral": {"turns": 2.0, "radius": 0.03},
    }


class SolverTable(Settings):
    """Which solver the third level asks."""

    KIND: ClassVar[str] = "[solver]"
    name: str = "exact"
    settings: dict[str, Any] = Field(default_factory=dict)
    replay_us: str | tuple[Annotated[float, Field(ge=0.0)], ...] | None = Field(
        default=None,
        description="solve times [us], or a .npy file of them, that stand for the clock's where a solve has a time "
        "budget, over and over: a run with deadlines can then be repeated exactly",
    )


class Scenario(Settings):
    """One run. ``Scenario()`` is the default: MOC with ``exact`` on a circle, in the realistic plant."""

    KIND: ClassVar[str] = "scenario:"
    name: str = "circle"
    seed: int = Field(default=0, ge=0, description="of starting swivel, mismatch and noise")
    robot: RobotTable = RobotTable()
    start: StartTable = StartTable()
    trocar: TrocarTable = TrocarTable()
    task: TaskTable = TaskTable()
    control: ControlSettings = ControlSettings()
    solver: SolverTable = SolverTable()
    plant: PlantSettings = PlantSettings.realistic()
    duration_s: float | None = Field(default=None, gt=0.0, description="stop early; None: the whole path")
    deadline_us: float = Field(default=2000.0, gt=0.0, description="a longer tick is a miss")
    guard: GuardSettings = GuardSettings()
    faults: FaultSettings = FaultSettings()
    judge: bool = Field(default=True, description="judge every answer after the run")
    bound_samples: int = Field(
        default=25, ge=0, le=100_000, description="points of the path at which the largest mu is scanned for"
    )

    @field_validator("control", mode="before")
    @classmethod
    def _control_preset(cls, value: Any) -> Any:
        if isinstance(value, Mapping) and "preset" in value:
            table = dict(value)
            return ControlSettings.preset(str(table.pop("preset")), **table)
        return value

    @field_validator("plant", mode="before")
    @classmethod
    def _preset(cls, value: Any) -> Any:
        if isinstance(value, Mapping) and "preset" in value:
            table = dict(value)
            presets = {"realistic": PlantSettings.realistic, "nominal": PlantSettings.nominal}
            name = table.pop("preset")
            if name not in list(presets):
                raise UnknownNameError("plant preset", str(name), presets)
            return presets[name](**table)
        return value

    @model_validator(mode="after")
    def _box_before_the_wall(self) -> Self:
        """The third level must not press where the guard pushes back: the arm would stand between the two."""
        box, wall = self.control.limit_margin_rad, self.guard.position_margin_rad
        if 0.0 < box < wall and self.control.law == "moc":
            raise ValueError(
                f"guard.position_margin_rad = {wall}: the wall would stand inside the box of the third level, which "
                f"closes at control.limit_margin_rad = {box}; set this to {wall} too (0: the paper's box)"
            )
        return self

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a TOML file.

        Raises:
            ScenarioError: no such file, no TOML, or a value out of range; names file and field.
            UnknownNameError: a key or preset that does not exist.
        """
        file = Path(path)
        try:
            table = tomllib.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise ScenarioError(f"{file}: no such file; give the path of a scenario in TOML") from error
        except tomllib.TOMLDecodeError as error:
            raise ScenarioError(f"{file}: not TOML: {error}") from error
        except (OSError, ValueError) as error:  # a ValueError: not UTF-8, or a NUL in the path
            raise ScenarioError(f"{file}: cannot be read: {error}") from error
        except RecursionError as error:
            raise ScenarioError(f"{file}: tables or lists in it are nested too deep") from error
        try:
            return cls(**table)
        except MocOptError as error:
            error.args = (f"{file}: {error}",)  # of whichever kind it is
            raise

    def change(self, **tables: Any) -> Self:
        """A copy with some fields changed; a mapping changes fields inside a table."""
        values: dict[str, Any] = {}
        for name in type(self).model_fields:
            old = getattr(self, name)
            new = tables.pop(name, old)
            if isinstance(old, BaseModel) and isinstance(new, Mapping) and "preset" not in new:
                new = type(old)(**{**{f: getattr(old, f) for f in type(old).model_fields}, **new})
            values[name] = new
        return type(self)(**values, **tables)


class Setup:
    """A scenario made flesh: robot, plant, references; ``trace()`` runs it."""

    def __init__(self, scenario: Scenario) -> None:
        """Build and check everything before anything moves.

        Raises:
            MocOptError: the first thing that is wrong, in its own words.
        """
        self.scenario = scenario
        start_seed, plant_seed, fault_seed = np.random.SeedSequence(scenario.seed).generate_state(3).tolist()
        table = scenario.robot
        self.robot = load_robot(table.name, tool_length=table.tool_length_m, tool_mass=table.tool_mass_kg)
        self.q_start = self._start_pose(np.random.default_rng(start_seed))
        self.plant = Plant(self.robot.data, scenario.plant, seed=plant_seed)
        if scenario.faults.bump_N > 0.0:  # an unknown link is found now, not in the middle of the run
            self.plant.push(scenario.faults.bump_link, np.zeros(3))
        self.plant.reset(self.q_start)
        self._fault_seed = fault_seed
        self._replayed_us = _recorded_times(scenario)
        state = self.robot.state(self.q_start)

        trocar = scenario.trocar
        if not trocar.depth_m < state.tool_span:
            raise ScenarioError(
                f"[trocar] depth_m = {trocar.depth_m}: wrist and tip are {state.tool_span:.3f} m apart; "
                "the trocar must lie between them"
            )
        point = state.tip - trocar.depth_m * state.tool_direction
        breathing = (trocar.breathing_amplitude_m, trocar.breathing_period_s, trocar.breathing_direction)
        self.registered = Trocar(point, *(breathing if trocar.breathing_known else (0.0,)))
        self.trocar = Trocar(point + self.plant.mismatch.registration_error, *breathing)

        task = scenario.task
        sizes = {**TaskTable.DEFAULT_SIZES.get(task.path, {}), **task.sizes}
        path = make_path(task.path, state.tip, normal=task.normal, heading=task.heading, **sizes)
        self.reference = Reference(path, task.v_max_m_per_s, task.a_max_m_per_s2, t_start=task.wait_s)
        self.duration_s = scenario.duration_s or task.wait_s + self.reference.duration + task.hold_s
        if not self.duration_s / scenario.plant.period_s <= MOST_TICKS:
            raise ScenarioError(
                f"{self.duration_s:.3g} s (duration_s, or the [task] with its v_max_m_per_s, a_max_m_per_s2, wait_s, "
                f"hold_s) in [plant] period_s = {scenario.plant.period_s:.3g} s: more than {MOST_TICKS} ticks"
            )

    def _start_pose(self, rng: np.random.Generator) -> Array:
        start = self.scenario.start
        q = np.array(self.robot.data.q_home if start.q_rad is None else start.q_rad, dtype=np.float64)
        if start.swivel == "given":
            return q
        fraction = rng.uniform(0.05, 0.95) if start.swivel == "random" else float(start.swivel)
        return self_motion(self.robot, q).at(fraction)

    def solver(self) -> Solver | None:
        """The solver that the scenario asks for; None under DCAC."""
        if self.scenario.control.law != "moc":
            return None
        solver = make_solver(self.scenario.solver.name, self.robot, **self.scenario.solver.settings)
        faults = self.scenario.faults
        if faults.solver == "none" or faults.solver == "hang":
            return solver
        return Faulty(solver, faults.solver, faults.solver_share, self._fault_seed)

    def controller(self) -> Controller:
        """The law and solver that the scenario asks for."""
        settings, times = self.scenario.control, self._replay()
        if self.scenario.faults.solver == "hang" and settings.law == "moc":
            # Replayed times, not a clock: the same seed is late at the same ticks on any machine.
            watch = settings.supervisor
            budget = watch.budget_us or self.scenario.deadline_us
            settings = settings.model_copy(
                update={"supervisor": watch.model_copy(update={"budget_us": budget})}
            )
            # one more in front, because a tick is run for nothing before the loop
            times = itertools.chain([0.0], np.where(self.spoilt(), 10.0 * budget, 0.0))
        return Controller(self.robot, settings, self.solver(), self.scenario.plant.period_s, times)

    def _replay(self) -> Iterator[float] | None:
        """The recorded solve times from the start, their first one twice: a tick is run for nothing before the loop."""
        times = self._replayed_us
        return None if times is None else itertools.chain(times[:1], itertools.cycle(times))

    def spoilt(self) -> NDArray[np.bool_]:
        """At which ticks the solver's answer is spoilt on purpose, (N,)."""
        faults, ticks = self.scenario.faults, len(self.times())
        if faults.solver == "none" or self.scenario.control.law != "moc":
            return np.zeros(ticks, dtype=np.bool_)
        return draw(self._fault_seed, faults.solver_share, ticks)

    def brain(self) -> Brain:
        """The controller as the loop wants it, in Python or compiled."""
        if self.scenario.control.backend == "c":
            if self.scenario.faults.solver != "none":
                raise ScenarioError(
                    f"[faults] solver = {self.scenario.faults.solver!r}: a compiled tick has no solver to spoil; "
                    "take [control] backend = 'python'"
                )
            from moc_opt.embedded import NativeController  # late: nobody else needs CasADi and a compiler

            return NativeController(
                self.robot, self.scenario.control, self.solver(), self.scenario.plant.period_s
            )
        return Driver(self.controller())

    def times(self) -> Array:
        """Start of every tick [s]."""
        period = self.scenario.plant.period_s
        ticks = max(1, round(self.duration_s / period))
        return period * np.arange(ticks, dtype=np.float64)

    def trace(self, watch: Callable[[int], None] | None = None) -> Trace:
        """Run, judge, and return what is left behind."""
        t = self.times()
        if self.plant.time > 0.0:
            self.plant.reset(self.q_start)
        meta = {
            "scenario": self.scenario.model_dump(mode="json"), "deadline_us": self.scenario.deadline_us,
            "robot": self.robot.data.name, "start_q_rad": self.q_start.tolist(),
        }  # fmt: skip
        period, guard, wrong = self.scenario.plant.period_s, self.scenario.guard, self.scenario.faults
        faults = Faults(wrong, self.robot.n, period, self._fault_seed)
        trace = simulate(
            self.plant, self.brain(), np.stack(self.reference.at(t), axis=1),
            faults.slip(np.stack(self.trocar.at(t), axis=1), t), np.stack(self.registered.at(t), axis=1),
            guard=Guard(self.robot.data, guard, period, self.robot.gravity),
            faults=faults if wrong.around_the_arm else None,
            stop=Stop(guard.stop_damping_Nm_s_per_rad, guard.stop_s), watch=watch, meta=meta,
        )  # fmt: skip
        if wrong.solver != "none":
            trace = trace.with_columns(injected=self.spoilt()[: len(trace)])
        mu = self.robot.mu_along(trace.q_rad)
        return self._judged(trace.with_columns(mu=mu, mu_bound=self._mu_bound(trace)))

    def _mu_bound(self, trace: Trace) -> Array:
        """Largest mu on the feasible self-motion, at evenly spaced ticks; NaN between them and where q is singular."""
        bound = np.full(len(trace), np.nan)
        samples = min(self.scenario.bound_samples, len(trace))
        for k in np.linspace(0, len(trace) - 1, samples).astype(int):
            inside = np.clip(trace.q_rad[k], self.robot.q_min, self.robot.q_max)
            try:
                bound[k] = self_motion(self.robot, inside).mu_best
            except RobotError:
                continue  # no single curve leads through a singular pose
        return bound

    def _judged(self, trace: Trace) -> Trace:
        if "subproblem" not in trace.columns or not self.scenario.judge:
            return trace
        found = judge(trace.subproblem, trace.x_rad_per_s, trace.dual)
        silent = ~np.isfinite(trace.x_rad_per_s).all(axis=1) & (trace.status != Status.SOLVED.label)
        columns = {name: np.where(silent, np.nan, figure) for name, figure in found._asdict().items()}
        return trace.with_columns(verified=found.verified(), **columns)


def _recorded_times(scenario: Scenario) -> list[float] | None:
    """The times of ``[solver] replay_us``, read and checked; None where the clock decides.

    Raises:
        ScenarioError: a file that holds no such times, or a controller that cannot take them.
    """
    given = scenario.solver.replay_us
    if given is None:
        return None
    if scenario.control.backend == "c":
        raise ScenarioError(
            "[solver] replay_us: the compiled tick takes no recorded times; take backend 'python'"
        )
    try:
        times = np.asarray(
            np.load(given, allow_pickle=False) if isinstance(given, str) else given, dtype=float
        )
    except (OSError, ValueError) as error:
        raise ScenarioError(f"[solver] replay_us = {given!r}: no .npy file of numbers: {error}") from error
    if times.ndim != 1 or times.size == 0 or not (np.isfinite(times) & (times >= 0.0)).all():
        raise ScenarioError(
            f"[solver] replay_us: shape {times.shape}: give one time of 0 us or more a tick, at least one"
        )
    return [float(time) for time in times]


class Driver:
    """Connects a controller to the loop: measurements become a model state, and the answers become columns."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self._robot = controller, controller.robot
        self.tip: Array = np.zeros(3)
        """Where the last tick saw the tip (3,) [m]."""

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """See ``sim.loop.Brain``; one tick is run for nothing, so that no compiler runs in the loop."""
        state = self._robot.state(q, v)
        self.controller.start(state, tip_ref, trocar)
        self.controller.tick(state, tip_ref, trocar)
        self.controller.start(state, tip_ref, trocar)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """See ``sim.loop.Brain``."""
        state = self._robot.state(q, v)
        self.tip = state.tip
        return self.controller.tick(state, tip_ref, trocar)

    def sent(self, tau: Array) -> None:
        """See ``sim.loop.Brain``."""
        self.controller.sent(tau)

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """The third level's columns; none but the status under DCAC."""
        n = self._robot.n
        found: dict[str, NDArray[Any]] = {
            "status": np.full(ticks, "none", dtype="<U12"),
            "solve_us": np.full(ticks, np.nan),
        }
        if self.controller.solver is not None:
            found |= {
                "x_rad_per_s": np.full((ticks, n), np.nan), "dual": np.full((ticks, 6), np.nan),
                "applied_x_rad_per_s": np.full((ticks, n), np.nan), "subproblem": np.zeros((ticks, row_length(n))),
                "iterations": np.zeros(ticks, dtype=np.int32), "fault": np.full(ticks, "none", dtype="<U12"),
            }  # fmt: skip
        return found

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """See ``sim.loop.Brain``."""
        solution, qp = self.controller.solution, self.controller.subproblem
        if solution is None or qp is None:
            return
        columns["status"][row] = solution.status.label
        columns["solve_us"][row] = self.controller.solve_us
        columns["x_rad_per_s"][row] = solution.x
        columns["applied_x_rad_per_s"][row] = self.controller.answer
        if solution.y is not None:
            columns["dual"][row] = solution.y
        columns["subproblem"][row] = qp.row
        columns["iterations"][row] = solution.iterations
        columns["fault"][row] = self.controller.fault.label


def make_solver(name: str, robot: RobotModel, **settings: Any) -> Solver:
    """Create a solver, giving it the arm's kinematics where it can use them."""
    if "kinematics" not in settings and accepts(name, "kinematics"):
        settings = {**settings, "kinematics": robot.kinematics()}
    return solvers.create(name, **settings)


def run(scenario: Scenario, watch: Callable[[int], None] | None = None) -> Trace:
    """Run one scenario.

    Raises:
        MocOptError: what is wrong with it, before anything moves; or that the arm ran away.
    """
    return Setup(scenario).trace(watch)


__all__ = ["MocOptError", "RunAway", "Scenario", "Setup", "make_solver", "run"]
