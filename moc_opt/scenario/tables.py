"""A scenario's tables [robot], [start], [trocar], [task] and [solver]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from moc_opt.inputs.settings import Name, Settings
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.solvers.isolated import ProcessSettings
from moc_opt.solvers.registry import check_name, defaults
from moc_opt.tasks.curves import CURVES
from moc_opt.tasks.paths import sizes

Vector = tuple[float, float, float]


def _not_zero(vector: Vector) -> Vector:
    if not any(vector):
        raise ValueError("give a vector of non-zero length")
    return vector


Direction = Annotated[Vector, AfterValidator(_not_zero)]
MOST_S = 100_000.0  # upper limit of durations, such as a run's [s]


class RobotTable(Settings):
    """The arm and its tool."""

    KIND: ClassVar[str] = "[robot]"
    name: str = Field("lwr4", description="name of a robot from `moc-opt robots`, or path of a URDF or TOML file")
    tool_length_m: float | None = Field(None, gt=0.0, le=10.0)
    """length of the tool from its mount to its tip. By default, the robot's file gives it"""
    tool_mass_kg: float | None = Field(None, gt=0.0, le=1000.0)
    """mass of the tool. By default, the robot's file gives it"""

    def arm(self) -> RobotModel:
        """Load the robot. Raise a MocOptError if its files are wrong."""
        return load_robot(self.name, tool_length=self.tool_length_m, tool_mass=self.tool_mass_kg)


class StartTable(Settings):
    """The pose of the arm at the start of the run."""

    KIND: ClassVar[str] = "[start]"
    pose: Literal["home", "random"] = "home"
    """start pose. 'home': given by `q_rad`; 'random': a random pose from which the arm can do the whole task"""
    q_rad: tuple[float, ...] | None = None
    """joint positions at the start, for `pose` = 'home'. By default, they are the robot's home pose"""
    swivel: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["given", "random"] = "given"
    """place of the elbow at the start. 'given': as in the start pose; a number: share (0 to 1) of the range in which
    the elbow can move while tip and wrist rest; 'random': a share drawn from 0.05 to 0.95. `moc-opt plan` prints
    angles, not such shares. To start at the best start that it finds, set `q_rad`"""
    limit_margin_rad: float = Field(0.05, ge=0.0, le=3.0)
    """smallest allowed distance of revolute joints from their limits along the path, for `pose` = 'random'"""
    limit_margin_m: float = Field(0.05, ge=0.0, le=3.0)
    """smallest allowed distance of prismatic joints from their limits along the path, for `pose` = 'random'"""
    check_path: bool = True
    """whether a path that the arm cannot follow is refused before the run. With `pose` = 'random', it is always
    refused"""

    @model_validator(mode="after")
    def _one_pose(self) -> Self:
        if self.pose == "random" and self.q_rad is not None:
            raise ValueError("pose = 'random' and q_rad exclude each other: remove one of them")
        return self


class TrocarTable(Settings):
    """The trocar (incision point). It lies on the tool's shaft at the start, and can move with the breathing."""

    KIND: ClassVar[str] = "[trocar]"
    depth_m: float = Field(0.15, gt=0.0, le=10.0, description="distance from the trocar to the tip at the start")
    breathing_amplitude_m: float = Field(0.0, ge=0.0, le=0.5)
    """largest distance by which the breathing moves the trocar from its place at the start"""
    breathing_period_s: float = Field(4.0, gt=0.0, le=MOST_S, description="duration of one breath")
    breathing_direction: Direction = (0.0, 0.0, 1.0)
    """direction of the breathing motion in base axes. The vector's length has no effect"""
    breathing_known: bool = True
    """whether the controller knows the breathing motion. If not, it assumes a trocar at rest"""

    @property
    def breathing(self) -> tuple[float, float, Vector]:
        """Amplitude [m], period [s] and direction of the trocar's motion."""
        return self.breathing_amplitude_m, self.breathing_period_s, self.breathing_direction


class TaskTable(Settings):
    """The path of the tip."""

    KIND: ClassVar[str] = "[task]"
    path: Name = "circle"
    """name of the path, from `moc-opt tasks`. 'waypoints' is a smooth curve through `waypoints_m`"""
    sizes: dict[Name, Annotated[float, Field(ge=-1e3, le=1e3)]] = Field(default_factory=dict)
    """sizes of the path, with lengths in m. `moc-opt tasks` lists their names and defaults"""
    waypoints_m: tuple[Vector, ...] | None = None
    """waypoints relative to the tip at the start. Their coordinates are along `heading`, left (`normal` x `heading`),
    and `normal`"""
    normal: Direction = (0.0, 0.0, 1.0)
    """vector perpendicular to the plane of the path, in base axes"""
    heading: Direction = (1.0, 0.0, 0.0)
    """direction in which the path begins, in base axes. It is projected onto the path's plane"""
    v_max_m_per_s: float = Field(0.05, gt=0.0, le=10.0, description="largest speed of the tip")
    a_max_m_per_s2: float = Field(0.2, gt=0.0, le=1e6, description="largest acceleration of the tip, including curves")
    wait_s: float = Field(0.5, ge=0.0, le=MOST_S, description="time at rest before the path")
    hold_s: float = Field(0.5, ge=0.0, le=MOST_S, description="time at rest after the path")

    @model_validator(mode="before")
    @classmethod
    def _points_are_a_path(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and values.get("waypoints_m") is not None and "path" not in values:
            return {**values, "path": "waypoints"}
        return values

    @model_validator(mode="after")
    def _known_path(self) -> Self:
        if self.path == "waypoints" and self.waypoints_m is None:
            raise ValueError("path = 'waypoints': give waypoints_m")
        if self.path != "waypoints" and self.waypoints_m is not None:
            raise ValueError(f"path = {self.path!r}: remove waypoints_m, or set path = 'waypoints'")
        sizes(self.path, self.sizes)
        return self

    @property
    def in_words(self) -> str:
        """The path and its sizes, for messages."""
        given = "".join(f", {name} = {size:g}" for name, size in self.sizes.items())
        return f"[task] path = {self.path!r}{given}{' (lengths in m)' if given else ''}"

    @classmethod
    def keys(cls, values: Mapping[str, Any]) -> list[str]:
        """List the keys of the table and of ``sizes``."""
        return [*super().keys(values), *sorted({f"sizes.{name}" for path in CURVES for name in sizes(path)})]


class SolverTable(Settings):
    """The solver of level 3, which moves the elbow. It computes the joint velocity x that level 3 follows."""

    KIND: ClassVar[str] = "[solver]"
    name: Name = Field("exact", description="name of the solver, from `moc-opt solvers --list`")
    settings: dict[Name, Any] = Field(default_factory=dict)
    """settings of the solver. docs/solvers.md explains them"""
    replay_us: str | tuple[Annotated[float, Field(ge=0.0, le=1e9)], ...] | None = None
    """recorded solve times, or name of a .npy file with solve times. These times replace the measured times, so that a
    run with a time budget can be repeated exactly"""
    isolation: Literal["none", "process"] = "none"
    """where the solver runs. 'none': in the controller's process; 'process': in its own process, which is replaced if
    it hangs or ends"""
    process: ProcessSettings = ProcessSettings()

    @model_validator(mode="after")
    def _known(self) -> Self:
        check_name(self.name)
        return self

    @classmethod
    def keys(cls, values: Mapping[str, Any]) -> list[str]:
        """List the keys of the table and of the solver's settings."""
        return [*super().keys(values), *(f"settings.{name}" for name in defaults(values.get("name", "exact")))]
