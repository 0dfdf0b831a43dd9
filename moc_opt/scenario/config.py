"""What a run is, as a validated table: every key of a scenario's TOML."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from moc_opt.control import ControlSettings
from moc_opt.control.isolated import ProcessSettings
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError, shown
from moc_opt.inputs.files import LARGEST_INTEGER, as_path, read_toml
from moc_opt.inputs.notebook import table_html
from moc_opt.inputs.settings import Name, Settings
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.realtime.settings import WireSettings
from moc_opt.scenario import saving
from moc_opt.sim.faults import FaultSettings
from moc_opt.sim.sensors import longest_repetition
from moc_opt.sim.settings import PlantSettings

Vector = tuple[float, float, float]
MOST_S = 100_000.0
"""Longest time of a run or of a part of it [s]."""


class RobotTable(Settings):
    """Which arm, and which tool on it."""

    KIND: ClassVar[str] = "[robot]"
    name: str = Field(default="lwr4", description="a robot of the package, or a path to a URDF or TOML")
    tool_length_m: float | None = Field(
        default=None, gt=0.0, le=10.0, description="mount to tip; None: that of the robot's file"
    )
    tool_mass_kg: float | None = Field(default=None, gt=0.0, le=1000.0, description="None: that of the robot's file")

    def arm(self) -> RobotModel:
        """Load the robot, and build its model.

        Raises:
            MocOptError: no such robot, or something is wrong with its files.
        """
        return load_robot(self.name, tool_length=self.tool_length_m, tool_mass=self.tool_mass_kg)


class StartTable(Settings):
    """The pose of the arm at t = 0; tip and wrist are those of q whatever the swivel."""

    KIND: ClassVar[str] = "[start]"
    pose: Literal["home", "random"] = Field(
        default="home", description="'random': drawn by the seed until the whole task can be done from it"
    )
    q_rad: tuple[float, ...] | None = Field(default=None, description="in place of the robot's home pose")
    swivel: float | Literal["given", "random"] = Field(
        default="given",
        description="place on the feasible self-motion, 0 to 1; 'given' leaves q; 'random' is drawn by the seed",
    )
    limit_margin_rad: float = Field(
        default=0.05,
        ge=0.0,
        le=3.0,
        description="under pose 'random': what a joint keeps from its limits at the start and along the path; below "
        "control.limit_margin_rad the third level begins with a joint on its way back from the limit",
    )
    limit_margin_m: float = Field(default=0.05, ge=0.0, le=3.0, description="the same for a joint that slides")
    check_path: bool = Field(
        default=True,
        description="refuse a path that kinematics alone cannot follow; the search may miss a way that exists",
    )

    @field_validator("swivel")
    @classmethod
    def _a_fraction(cls, value: float | str) -> float | str:
        if isinstance(value, float) and not 0.0 <= value <= 1.0:
            raise ValueError("a swivel is a fraction from 0 to 1")
        return value

    @model_validator(mode="after")
    def _one_pose(self) -> Self:
        if self.pose == "random" and self.q_rad is not None:
            raise ValueError("pose = 'random' and q_rad exclude each other: leave one of them out")
        return self


class TrocarTable(Settings):
    """Where the shaft enters: a point on it at t = 0, then fixed or breathing."""

    KIND: ClassVar[str] = "[trocar]"
    depth_m: float = Field(default=0.15, gt=0.0, le=10.0, description="of the tip below the trocar at t = 0")
    breathing_amplitude_m: float = Field(default=0.0, ge=0.0, le=0.5, description="of the trocar's motion; 0: it rests")
    breathing_period_s: float = Field(default=4.0, gt=0.0, le=MOST_S, description="of one breath")
    breathing_direction: Vector = Field(default=(0.0, 0.0, 1.0), description="of that motion, base axes, any length")
    breathing_known: bool = Field(
        default=True, description="whether the registered trocar follows the breathing"
    )


class TaskTable(Settings):
    """The path of the tip."""

    KIND: ClassVar[str] = "[task]"
    path: Name = Field(
        default="circle", description="`moc-opt tasks` lists them; 'waypoints': a smooth curve through waypoints_m"
    )
    sizes: dict[Name, Annotated[float, Field(ge=-1e3, le=1e3)]] = Field(
        default_factory=dict, description="of the path [m]; see moc_opt.tasks"
    )
    waypoints_m: tuple[Vector, ...] | None = Field(
        default=None,
        description="where the tip goes, from where it starts: along the heading, to the left, along the normal",
    )
    normal: Vector = Field(default=(0.0, 0.0, 1.0), description="of the path's plane, base axes, any length")
    heading: Vector = Field(
        default=(1.0, 0.0, 0.0), description="in which the path begins; its part along the normal is taken out"
    )
    v_max_m_per_s: float = Field(default=0.05, gt=0.0, le=1e3, description="largest speed of the tip")
    a_max_m_per_s2: float = Field(
        default=0.2, gt=0.0, le=1e6, description="largest acceleration of the tip, bends included"
    )
    wait_s: float = Field(default=0.5, ge=0.0, le=MOST_S, description="rest before the path")
    hold_s: float = Field(default=0.5, ge=0.0, le=MOST_S, description="rest after it")

    @model_validator(mode="before")
    @classmethod
    def _points_are_a_path(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and values.get("waypoints_m") is not None and "path" not in values:
            return {**values, "path": "waypoints"}
        return values

    @model_validator(mode="after")
    def _points_for_waypoints(self) -> Self:
        if (self.path == "waypoints") != (self.waypoints_m is not None):
            other = "leave waypoints_m out, or set path = 'waypoints'"
            cure = "give waypoints_m" if self.waypoints_m is None else other
            raise ValueError(f"path = {self.path!r}: {cure}")
        return self

    DEFAULT_SIZES: ClassVar[dict[str, dict[str, float]]] = {
        "line": {"length": 0.04},
        "circle": {"radius": 0.03},
        "sinusoid": {"amplitude": 0.01, "wavelength": 0.02, "periods": 2.0},
        "spiral": {"turns": 2.0, "radius": 0.03},
    }


class SolverTable(Settings):
    """Which solver the third level asks."""

    KIND: ClassVar[str] = "[solver]"
    name: Name = Field(default="exact", description="`moc-opt solvers --list` lists them")
    settings: dict[Name, Any] = Field(default_factory=dict, description="of that solver: docs/solvers.md")
    replay_us: str | tuple[Annotated[float, Field(ge=0.0, le=1e9)], ...] | None = Field(
        default=None,
        description="solve times [us], or a .npy file of them, that stand for the clock's where a solve has a time "
        "budget, over and over: a run with deadlines can then be repeated exactly",
    )
    isolation: Literal["none", "process"] = Field(
        default="none", description="'process': the session runs in a process of its own, which is killed if it hangs"
    )
    process: ProcessSettings = ProcessSettings()


class Scenario(Settings):
    """One run. ``Scenario()`` is the default: MOC with ``exact`` on a circle, in the realistic plant."""

    KIND: ClassVar[str] = "scenario:"
    name: Name = Field(default="circle", description="title of the run")
    seed: int = Field(
        default=0, ge=0, le=LARGEST_INTEGER, description="of starting pose and swivel, mismatch and noise"
    )
    robot: RobotTable = RobotTable()
    start: StartTable = StartTable()
    trocar: TrocarTable = TrocarTable()
    task: TaskTable = TaskTable()
    control: ControlSettings = ControlSettings()
    solver: SolverTable = SolverTable()
    plant: PlantSettings = PlantSettings.realistic()
    duration_s: float | None = Field(default=None, gt=0.0, le=MOST_S, description="stop early; None: the whole path")
    deadline_us: float = Field(default=2000.0, gt=0.0, le=1e9, description="a longer tick is a miss")
    guard: SafetyFilterSettings = SafetyFilterSettings()
    faults: FaultSettings = FaultSettings()
    wire: WireSettings = WireSettings()
    judge: bool = Field(default=True, description="judge every answer after the run")
    metrics: tuple[Name, ...] = Field(
        default=(),
        description="that `moc-opt run` prints, of those that `moc-opt metrics` lists; empty: those to look at first",
    )
    bound_samples: int = Field(
        default=25, ge=0, le=100_000, description="points of the path at which the largest mu is looked for"
    )
    best_courses: bool = Field(
        default=False,
        description="plan the path's best courses after the run, which mu is then compared with; a second or more",
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
        """Refuse a box in which the third level presses against the safety filter's wall: the arm would stand."""
        for unit in ("rad", "m"):
            box, wall = getattr(self.control, f"limit_margin_{unit}"), getattr(self.guard, f"position_margin_{unit}")
            if 0.0 < box < wall and self.control.law == "moc":
                raise ValueError(
                    f"guard.position_margin_{unit} = {wall}: the wall would stand inside the box of the third level, "
                    f"which closes at control.limit_margin_{unit} = {box}; set this to {wall} too (0: the paper's box)"
                )
        return self

    @model_validator(mode="after")
    def _isolated_by_what_can(self) -> Self:
        if self.solver.isolation == "process" and self.control.law == "moc":
            if self.control.backend == "c":
                raise ValueError(
                    "[solver] isolation = 'process': the compiled tick holds its solver; take [control] backend = "
                    "'python', or isolation = 'none'"
                )
            if self.control.supervisor.late == "iterate":
                raise ValueError(
                    "[control.supervisor] late = 'iterate': what an isolated solver has when its budget ends is not "
                    "there; take 'hold' or 'zero', or [solver] isolation = 'none'"
                )
        return self

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a TOML file; the path of a robot's file in it is relative to the scenario's folder.

        Raises:
            ScenarioError: no such file, no TOML, or a value out of range; names file and field.
            UnknownNameError: a key or preset that does not exist.
        """
        file = as_path(path, "scenario", ScenarioError)
        if file.suffix == ".parquet":
            raise ScenarioError(f"{file} is a trace, no scenario: moc-opt report, replay or map shows it")
        table = _with_paths_from(file.parent, read_toml(file, "scenario", ScenarioError))
        try:
            return cls(**table)
        except MocOptError as error:
            error.args = (f"{file}: {error}",)  # of whichever kind it is
            raise

    @classmethod
    def given(cls, scenario: object) -> Self:
        """Return what a caller gave as a scenario: one as it is, of a path that of the file.

        Raises:
            ScenarioError: it is neither; or as `load`.
        """
        if isinstance(scenario, cls):
            return scenario
        if isinstance(scenario, str | os.PathLike):
            return cls.load(scenario)
        raise ScenarioError(f"scenario = {shown(scenario)}: give a Scenario, or the path of a scenario's file")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the TOML that `load` reads as this scenario: what differs from the defaults.

        A robot's own file is named by its absolute path.

        Raises:
            ScenarioError: a solver's setting has no form in TOML, or the file cannot be written.
        """
        saving.save(self, path)

    def __repr__(self) -> str:
        return f"Scenario({', '.join(f'{name}={value!r}' for name, value in saving.changes(self).items())})"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Show itself in a notebook."""
        return table_html("Scenario, where it differs from the default", saving.changes(self))

    def change(self, **tables: Any) -> Self:
        """Copy the scenario with some fields changed; a mapping changes fields inside a table."""
        values: dict[str, Any] = {}
        for name in type(self).model_fields:
            old = getattr(self, name)
            new = tables.pop(name, old)
            if isinstance(old, Settings) and isinstance(new, Mapping) and "preset" not in new:
                new = old.replace(new)
            values[name] = new
        return type(self)(**values, **tables)

    @property
    def told_guard(self) -> SafetyFilterSettings:
        """``[guard]``, and what it is told of the encoders where it does not say it itself."""
        if self.guard.repeat_joint_ticks is not None:
            return self.guard
        longest = longest_repetition(self.plant.encoder_noise_rad, self.plant.encoder_resolution_rad)
        return self.guard.model_copy(update={"repeat_joint_ticks": longest})


def _with_paths_from(folder: Path, table: dict[str, Any]) -> dict[str, Any]:
    """The table with the robot's file, where one is given, taken from the scenario's own folder."""
    robot = table.get("robot")
    name = robot.get("name") if isinstance(robot, Mapping) else None
    if robot is None or not isinstance(name, str) or Path(name).suffix.lower() not in (".toml", ".urdf"):
        return table
    return {**table, "robot": {**robot, "name": str(folder / name)}}
