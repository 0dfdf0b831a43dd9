"""A scenario as the TOML that makes it: only values that differ from the defaults."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moc_opt.control.settings import PRESETS, ControlSettings
from moc_opt.errors import ScenarioError, shown
from moc_opt.inputs.files import as_path, to_toml, write_whole
from moc_opt.inputs.settings import Settings
from moc_opt.sim.settings import PlantSettings

if TYPE_CHECKING:
    from moc_opt.scenario.config import Scenario


def changes(scenario: Scenario) -> dict[str, Any]:
    """Return what differs from the default scenario, as the keyword arguments that make it.

    A table is written against its defaults or against that preset which leaves fewest keys.
    """
    found: dict[str, Any] = {}
    for name, field in type(scenario).model_fields.items():
        value = getattr(scenario, name)
        if value == field.default:
            continue
        found[name] = min(_tables(value), key=len) if isinstance(value, Settings) else value
    return found


def _tables(value: Settings) -> Iterator[dict[str, Any]]:
    """Yield the ways to write a table: with no preset, then with each that it has."""
    yield _differences(value, type(value)())
    presets: dict[str, Settings] = {}
    if isinstance(value, ControlSettings):
        presets = {name: ControlSettings.preset(name) for name in PRESETS}
    elif isinstance(value, PlantSettings):
        presets = {"nominal": PlantSettings.nominal()}
    for name, preset in presets.items():
        table = _differences(value, preset)
        if None not in table.values():  # what a preset sets, a file cannot set back to None
            yield {"preset": name, **table}


def _differences(value: Settings, base: Settings) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in type(value).model_fields:
        entry = getattr(value, name)
        if entry != getattr(base, name):
            found[name] = min(_tables(entry), key=len) if isinstance(entry, Settings) else entry
    return found


def save(scenario: Scenario, path: str | os.PathLike[str]) -> None:
    """See `Scenario.save`."""
    file = as_path(path, "scenario", ScenarioError)
    table = changes(scenario)
    name = scenario.robot.name
    if Path(name).suffix.lower() in (".toml", ".urdf"):  # read again, it would count from the folder of the file
        table["robot"] = {**table["robot"], "name": str(Path(name).absolute())}
    if scenario.control.course:
        table["control"] = {**table["control"], "course": str(Path(scenario.control.course).absolute())}
    if None in scenario.solver.settings.values():
        table["solver"] = {**table["solver"], "settings": _given_settings(scenario)}
    try:
        text = to_toml(_without_none(table))
    except TypeError as error:
        raise ScenarioError(f"the scenario cannot be written as TOML: {error}") from error
    write_whole(file, text, "scenario", ScenarioError)


def _given_settings(scenario: Scenario) -> dict[str, Any]:
    """Return the solver's settings without those that are None where the solver has None by itself; a file has no None.

    Raises:
        ScenarioError: a setting is None where the solver's own default is another.
    """
    from moc_opt.solvers.registry import defaults

    solver, kept = scenario.solver, {}
    known = defaults(solver.name)
    for name, value in solver.settings.items():
        if value is None and known.get(name, ...) is not None:
            raise ScenarioError(
                f"[solver.settings] {name} = None has no form in TOML, and left out it would be "
                f"{shown(known.get(name, 'unknown'))}: give a value"
            )
        if value is not None:
            kept[name] = value
    return kept


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """Write None as a file does: no limit is `inf`, no table of gains an empty text."""
    plain: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping) and key != "settings":
            plain[key] = _without_none(value)
        else:
            plain[key] = ("" if key == "gains" else float("inf")) if value is None else value
    return plain
