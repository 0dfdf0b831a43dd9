"""The validated settings of a run."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from moc_opt.control import ControlSettings
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.control.settings import PRESETS as CONTROL_PRESETS
from moc_opt.errors import ScenarioError, UnknownNameError, named
from moc_opt.inputs.files import as_path, read_toml, to_toml, write_whole
from moc_opt.inputs.settings import LARGEST_INTEGER, Name, Settings
from moc_opt.realtime.wire import WireSettings
from moc_opt.scenario.tables import MOST_S, RobotTable, SolverTable, StartTable, TaskTable, TrocarTable
from moc_opt.sim.faults import FaultSettings
from moc_opt.sim.sensors import longest_repetition, repeats_no_reading
from moc_opt.sim.settings import PlantSettings

PRESETS: Mapping[str, Mapping[str, Callable[..., Settings]]] = {
    "control": {name: partial(ControlSettings.preset, name) for name in CONTROL_PRESETS},
    "plant": {"realistic": PlantSettings, "nominal": PlantSettings.nominal},
}
"""``PRESETS[table][preset](**changes)`` makes the settings of the table."""
_LAGS = 3.0  # lower bound on motion_lag_s [time constants of the velocity filter]
_TORQUE, _SPEED = 500.0, 600.0
"""Lower bounds, for an encoder step s [rad]: repeat_torque >= _TORQUE s, and stuck_rad_per_s >= _SPEED s."""


class Scenario(Settings):
    """Settings of one run. By default, the arm follows a circle with all three levels and the solver `exact`.

    Every key of the TOML file is a field, and every table is a nested model.

    Raises:
        ScenarioError: a value is out of range, or fields contradict each other.
        UnknownNameError: a key, preset, solver or path does not exist.
    """

    KIND: ClassVar[str] = "scenario:"
    name: Name = Field("circle", description="title of the run")
    seed: int = Field(0, ge=0, le=LARGEST_INTEGER)
    """seed of all random numbers: start pose, plant errors, noise and faults"""
    robot: RobotTable = RobotTable()
    start: StartTable = StartTable()
    trocar: TrocarTable = TrocarTable()
    task: TaskTable = TaskTable()
    control: ControlSettings = ControlSettings()
    solver: SolverTable = SolverTable()
    plant: PlantSettings = PlantSettings()
    duration_s: float | None = Field(None, gt=0.0, le=MOST_S)
    """duration of the run. By default, the run lasts for the path plus `wait_s` and `hold_s` of [task]"""
    deadline_us: float = Field(2000.0, gt=0.0, le=1e9)
    """computation time of a control period, above which a deadline miss is counted. The run continues. `budget_us` of
    [control.supervisor] limits the time of one solve"""
    guard: SafetyFilterSettings = SafetyFilterSettings()
    faults: FaultSettings = FaultSettings()
    wire: WireSettings = WireSettings()
    judge: bool = True
    """whether the optimality residuals of every solver answer are computed after the run"""
    metrics: tuple[Name, ...] = ()
    """names of the metrics that `moc-opt run` prints, from `moc-opt metrics`. If empty, the main metrics are printed"""
    bound_samples: int = Field(25, ge=0, le=100_000)
    """number of control periods at which the largest manipulability for fixed tip and wrist is computed"""
    best_courses: bool = False
    """whether the courses (joint motions) of largest mean manipulability are planned after the run, for comparison.
    With `moc-opt run`, the default is true"""

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except UnknownNameError as error:
            if error.kind.endswith(" key") and (places := self._places(error.name)):
                wrong = f"unknown {error.kind} {error.name!r:.100}"
                error.args = (f"{wrong}: a key of that name belongs {' or '.join(places)}",)
            raise

    @classmethod
    def _places(cls, key: str) -> list[str]:
        tables = {name: field.annotation for name, field in cls.model_fields.items()}
        inside = [f"in [{name}]" for name, kind in tables.items() if key in getattr(kind, "model_fields", {})]
        return ["at the top of the file, above all tables", *inside] if key in tables else inside

    @field_validator(*PRESETS, mode="before")
    @classmethod
    def _preset(cls, value: Any, info: ValidationInfo) -> Any:
        if not isinstance(value, Mapping) or "preset" not in value:
            return value
        table, presets = dict(value), PRESETS[str(info.field_name)]
        name = table.pop("preset")
        if name not in list(presets):
            raise UnknownNameError(f"{info.field_name} preset", str(name), presets)
        return presets[name](**table)

    @model_validator(mode="after")
    def _check_third_level_box(self) -> Self:
        for unit in ("rad", "m"):
            name = "course_margin_rad" if unit == "rad" and self.control.follows else f"limit_margin_{unit}"
            box, wall = getattr(self.control, name), getattr(self.guard, f"position_margin_{unit}")
            if 0.0 < box < wall and self.control.law == "moc":
                raise ValueError(
                    f"guard.position_margin_{unit} = {wall} is larger than control.{name} = {box}, so the third "
                    f"level would press the arm against a wall of the safety filter: give {name} = {wall} or more, or 0"
                )
        return self

    @model_validator(mode="after")
    def _check_isolation(self) -> Self:
        control = self.control
        if self.solver.isolation == "process" and control.law == "moc" and control.supervisor.late == "iterate":
            raise ValueError(
                "[control.supervisor] late = 'iterate': a solver in its own process gives no iterate when "
                "its time budget ends; use late = 'hold' or 'zero', or [solver] isolation = 'none'"
            )
        return self

    @classmethod
    def load(cls, path: Self | str | os.PathLike[str]) -> Self:
        """Read a TOML file. Relative paths in the file start at the file's folder. Return a given `Scenario` unchanged.

        Raises:
            ScenarioError: the file is missing or not TOML, or a value is out of range.
            UnknownNameError: a key or preset does not exist.
        """
        if isinstance(path, cls):
            return path
        file = as_path(path, "scenario", ScenarioError)  # type: ignore[arg-type]
        if file.suffix == ".parquet":
            raise ScenarioError(f"{file} is a trace, not a scenario: `moc-opt report`, `replay` or `map` shows it")
        if file.suffix.lower() == ".urdf":
            made = f"`moc-opt robot new {file} --out arm.toml` makes a file for [robot] name = 'arm.toml' in a scenario"
            raise ScenarioError(f"{file} is a robot, not a scenario: {made}")
        table = read_toml(file, "scenario", ScenarioError)
        with named(f"{file}:"):
            return cls(**_with_files_in(file.parent, table))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a TOML file that `load` reads. Defaults are omitted, and paths become absolute.

        Raises:
            ScenarioError: a setting or the file cannot be written.
        """
        try:
            text = to_toml(without_none(_with_files_in(Path.cwd(), self.changes())))
        except TypeError as error:
            raise ScenarioError(f"the scenario cannot be written as TOML: {error}") from error
        write_whole(path, text, "scenario", ScenarioError)

    def changes(self) -> dict[str, Any]:
        """Return the non-default values by name."""
        found: dict[str, Any] = {}
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if value != field.default:
                found[name] = min(_tables(value, name), key=len) if isinstance(value, Settings) else value
        return found

    def __repr__(self) -> str:
        return f"Scenario({', '.join(f'{name}={value!r}' for name, value in self.changes().items())})"

    __str__ = __repr__

    @property
    def safety_settings(self) -> SafetyFilterSettings:
        """The settings ``[guard]``. Limits that are left out or too low for the plant's encoders are replaced."""
        guard, plant, told = self.guard, self.plant, dict[str, float | None]()
        encoder = plant.encoder_noise_rad, plant.encoder_resolution_rad
        if guard.repeat_joint_ticks is None:
            told["repeat_joint_ticks"] = longest_repetition(*encoder)
        if guard.repeat_reading_ticks is None and repeats_no_reading(
            *encoder, plant.velocity_cutoff_Hz, plant.period_s
        ):
            told["repeat_reading_ticks"] = guard.patience_ticks
        if plant.velocity_cutoff_Hz > 0.0:
            told["motion_lag_s"] = max(guard.motion_lag_s, _LAGS / (2.0 * math.pi * plant.velocity_cutoff_Hz))
        told["repeat_torque"] = max(guard.repeat_torque, _TORQUE * plant.encoder_resolution_rad)
        told["stuck_rad_per_s"] = max(guard.stuck_rad_per_s, _SPEED * plant.encoder_resolution_rad)
        return guard.model_copy(update=told)


def _with_files_in(folder: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(table)
    for name, key in (("robot", "name"), ("control", "course")):
        file = table[name].get(key) if isinstance(table.get(name), Mapping) else None
        if isinstance(file, str) and file and (key == "course" or Path(file).suffix.lower() in (".toml", ".urdf")):
            found[name] = {**table[name], key: str(folder / file)}
    return found


def _tables(value: Settings, name: str) -> Iterator[dict[str, Any]]:
    yield value.model_dump(exclude_defaults=True)
    for preset, make in PRESETS.get(name, {}).items():
        base, table = make(), dict[str, Any]()
        for key in type(value).model_fields:
            entry = getattr(value, key)
            if entry != getattr(base, key):
                table[key] = entry.model_dump(exclude_defaults=True) if isinstance(entry, Settings) else entry
        if None not in table.values():  # a file cannot reset a preset's value to None
            yield {"preset": preset, **table}


def without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """Copy a table without None: the key ``gains`` gets "", other keys infinity. In ``settings``, None is omitted."""
    plain: dict[str, Any] = {}
    for key, value in table.items():
        if key == "settings":
            plain[key] = {name: setting for name, setting in value.items() if setting is not None}
        elif isinstance(value, Mapping):
            plain[key] = without_none(value)
        else:
            plain[key] = ("" if key == "gains" else float("inf")) if value is None else value
    return plain
