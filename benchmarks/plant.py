"""How much accuracy does each defect of the arm cost? When does moving the elbow make the tip less accurate?

python -m benchmarks.plant [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

Registration: before a run, the arm touches path and incision, and so finds their positions in its own frame.
*Registered again*: it does so a second time, when the elbow has come to rest. This touch is not simulated, because it
hardly changes the motion. The errors after it are computed from the trace.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field

from moc_opt.figures.style import rule
from moc_opt.inputs.settings import Settings
from moc_opt.planning.elbow import in_transient
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim.settings import PlantSettings
from moc_opt.study import Failed, Job
from moc_opt.study.command import Found, Study, StudyConfig, command
from moc_opt.study.results import BASE_FRAME, ERRORS, FRAMES, TITLES, Results, change_name
from moc_opt.study.show import Picture, Report, Section, columns, ends, lines_picture
from moc_opt.study.statistics import spread, too_few
from moc_opt.study.trials import BASELINE, Run, Trial, run_and_trace, seeds, trials
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace.trace import Trace

EFFECTS_STREAM, CALIBRATION_STREAM = 10, 9
KINDS = {"origins": "mm", "encoders": "mrad", "both": "mm and mrad"}  # calibration errors, and units of their sizes
TILT_RAD_PER_M = PlantSettings().calibration_tilt_rad / PlantSettings().calibration_error_m
DEFAULT_SIZE_MM = 0.2  # the report's first sentences state MOC's tip errors for this error of the joint origins
LEAST_S = 0.5
"""Errors after the elbow's travel are means over at least this time."""
MOST_CHANGE_PERCENT, MOST_MM = 5.0, 0.1
AFTER = {
    "tip_after_mm": "tip after travel", "tip_again_mm": "tip registered again",
    "rcm_after_mm": "RCM after travel", "rcm_again_mm": "RCM registered again",
}  # fmt: skip
SHOWN = {**TITLES, **AFTER}
JUDGED = "tip_error_registered_mean_mm"
DEFINED = (
    "Break-even: the calibration error at which MOC's mean tip error reaches a limit. It is interpolated between the "
    "tried sizes. The tip error is measured in the frame registered at the start. The absolute limit is "
    f"{MOST_MM:g} mm. The relative limit is {MOST_CHANGE_PERCENT:g} % above DCAC's error with the same gains. The "
    "change from DCAC to MOC is estimated from the means and from the single trials. The relative limit is reached "
    f"when the 95 % intervals of both estimates lie above {MOST_CHANGE_PERCENT:g} % (see docs/method.md)."
)


class Sweep(Settings):
    KIND: ClassVar[str] = "[calibration]"
    trials: int = Field(5, ge=1, description="per task")
    duration_s: float | None = Field(4.0, gt=0.0, description="length of a run; None for the whole task")
    sizes: list[float] = Field([0.05, 0.1, 0.2, 0.3, 0.5], description="origins [mm] or encoders [mrad]; 0 is added")


class Config(StudyConfig):
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    trials: int = Field(5, ge=1, description="per task")
    presets: list[str] = Field(["tuned", "default"], min_length=1)
    solver: str = "exact"
    base: dict[str, Any] = Field(default_factory=dict, description="[plant], common to all effects")
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    calibration: Sweep = Sweep()
    scenario: Scenario = Scenario(judge=False, bound_samples=0)

    def quick(self) -> Self:
        sweep = self.calibration.model_copy(update={"trials": 2, "sizes": self.calibration.sizes[-1:]})
        less = {"tasks": self.tasks[:1], "trials": 2, "presets": self.presets[:1], "calibration": sweep}
        return self.model_copy(update=less)

    def plant(self, effect: str) -> PlantSettings:
        return PlantSettings(**self.scenario.plant.model_dump() | self.base | self.effects[effect])

    def cases(self, stream: int = EFFECTS_STREAM, count: int | None = None) -> list[Scenario]:
        drawn = seeds(self.seed, stream, (count or self.trials) * len(self.tasks))
        return trials(self.scenario, self.tasks, drawn, virtual=True)

    def under_presets(
        self, cases: Sequence[Scenario], plants: Sequence[tuple[dict[str, Any], PlantSettings]]
    ) -> Iterator[tuple[dict[str, Any], Scenario]]:
        for preset in self.presets:
            control = {} if preset == "default" else {"preset": preset}
            for tags, plant in plants:
                for case in cases:
                    yield {"preset": preset, **tags}, case.change(control=control, plant=plant.model_dump())


def plant_of(base: PlantSettings, kind: str, size: float) -> PlantSettings:
    """Return `base` with these calibration errors. Joint frames tilt in proportion to the origins' error."""
    origins = 1e-3 * size if kind in ("origins", "both") else 0.0
    encoders = 1e-3 * size if kind in ("encoders", "both") else 0.0
    return PlantSettings(**base.model_dump() | {
        "calibration_error_m": origins, "calibration_tilt_rad": TILT_RAD_PER_M * origins, "encoder_bias_rad": encoders,
    })  # fmt: skip


def work(study: Study, config: Config) -> Found:
    both, sweep = (BASELINE, config.solver), config.calibration
    defects = [({"part": "effects", "effect": name}, config.plant(name)) for name in config.effects]
    asked = [
        Trial(case, name, tags=tags) for tags, case in config.under_presets(config.cases(), defects) for name in both
    ]
    rows = Results(run.row for run in study.trials(asked, "defects"))
    sizes = [("both", 0.0), *((kind, size) for kind in KINDS for size in sweep.sizes)]
    plants = [
        ({"part": "calibration", "kind": kind, "size": size}, plant_of(config.scenario.plant, kind, size))
        for kind, size in sizes
    ]
    cases = [case.change(duration_s=sweep.duration_s) for case in config.cases(CALIBRATION_STREAM, sweep.trials)]
    pairs = [[Trial(case, name, tags=tags) for name in both] for tags, case in config.under_presets(cases, plants)]
    jobs = [Job(registered_again, tuple(pair), pair[0].job.limit_s) for pair in pairs]
    for pair, found in zip(pairs, study.run(jobs, "calibration errors"), strict=True):
        failed = [one.failed(str(found)) for one in pair] if isinstance(found, Failed) else found
        rows.add(*(run.row for run in failed))
    means = (*ERRORS, "trocar_force_mean_N", "torque_rate_rms_Nm_per_s")
    effects = {
        preset: {
            f"{effect}, {name}": rows.where(preset=preset, effect=effect).figures(name, means, ("mu_mean",))
            for effect in config.effects for name in both
        } for preset in config.presets
    }  # fmt: skip
    sizes_found = calibration(rows.where(part="calibration"), config.solver)
    summary = {"effects": effects, "calibration": sizes_found, "break_even": break_evens(sizes_found)}
    return Found(report(summary, config), summary, rows)


def registered_again(dcac: Trial, moc: Trial) -> list[Run]:
    """Run both controllers. Add the errors after the elbow's travel, if both runs are whole and long enough."""
    both = [run_and_trace(dcac), run_and_trace(moc)]
    found = [run for run, _ in both]
    whole = [trace for run, trace in both if trace is not None and run.row["whole"]]
    if len(whole) < 2:
        return found
    setup, t, q = Setup(moc.case), whole[1].t_s, whole[1].q_rad
    flags = np.flatnonzero(in_transient(setup.robot, t, q))
    tick = int(flags[-1]) + 1 if flags.size else 0
    if tick >= len(t) or t[-1] - t[tick] < LEAST_S:
        return found
    return [
        Run({**run.row, "arrived_s": float(t[tick]), **after_travel(trace, setup, tick)})
        for run, trace in zip(found, whole, strict=True)
    ]


def after_travel(trace: Trace, setup: Setup, tick: int) -> dict[str, float]:
    """Return mean errors [mm] from `tick` on, with the registration at the start and with a new one at `tick`."""
    # A touch shows how far the computed position is off, for the tip and for the shaft's point in the trocar.
    tips, wrists = setup.robot.tool_along(trace.q_rad + setup.plant.mismatch.encoder_bias)
    told = trace.trocar_registered_m - setup.offset.trocar  # the trocar in the controller's own frame
    depth = np.linalg.norm(told - tips, axis=1, keepdims=True)
    believed, true = tips - wrists, trace.tip_m - trace.wrist_m
    believed = tips - depth * believed / np.linalg.norm(believed, axis=1, keepdims=True)
    true = trace.tip_m - depth * true / np.linalg.norm(true, axis=1, keepdims=True)
    tip = np.linalg.norm(trace.tip_ref_m + (trace.tip_m - tips)[tick] - trace.tip_m, axis=1)
    rcm = shaft_distance(trace.tip_m, trace.wrist_m, told + (true - believed)[tick])
    errors = (trace.tip_error_registered_m, tip, trace.rcm_error_registered_m, rcm)
    return {name: 1e3 * float(error[tick:].mean()) for name, error in zip(AFTER, errors, strict=True)}


def calibration(rows: Results, solver: str) -> list[dict[str, Any]]:
    found = []
    for preset, kind in product(rows.names("preset"), KINDS):
        here = Results(row for row in rows.where(preset=preset) if row["kind"] == kind or row["size"] == 0.0)
        for size in sorted(here.names("size")):
            at = here.where(size=size)
            both = {
                f"{name}_{key}": value
                for name, controller in (("dcac", BASELINE), ("moc", solver))
                for key, value in at.figures(controller, tuple(SHOWN)).items()
            }
            changes = at.figures(solver, (), ("mu_mean", *SHOWN))
            found.append({"preset": preset, "kind": kind, "size": size, **both, **changes})
    return found


def break_evens(found: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return, for every preset and kind, the sizes at which the registered tip error crosses each limit."""
    evens = []
    for preset, kind in dict.fromkeys((row["preset"], row["kind"]) for row in found):
        mine = [row for row in found if (row["preset"], row["kind"]) == (preset, kind) and f"moc_{JUDGED}" in row]
        change, sizes = change_name(JUDGED), [row["size"] for row in mine]
        lows = [min(row[f"{change}_low"], row[f"{change}_of_ratios_low"]) for row in mine]
        compared = min((row["compared"] for row in mine), default=0)
        evens.append({
            "preset": preset, "kind": kind, "trials": compared, "undecided": too_few(compared) or "",
            "relative": crossing(sizes, lows, MOST_CHANGE_PERCENT),
            "absolute": crossing(sizes, [row[f"moc_{JUDGED}"] for row in mine], MOST_MM),
            "absolute_dcac": crossing(sizes, [row[f"dcac_{JUDGED}"] for row in mine], MOST_MM),
        })  # fmt: skip
    return evens


def crossing(sizes: Sequence[float], values: Sequence[float], limit: float) -> float | None:
    """Return the interpolated size above which all values exceed a limit, or None if the last value does not."""
    last = max((k for k, value in enumerate(values) if not value > limit), default=-1)
    if last == len(values) - 1:
        return None
    if last < 0:
        return sizes[0]
    share = (limit - values[last]) / (values[last + 1] - values[last])
    return float(sizes[last] + share * (sizes[last + 1] - sizes[last]))


def report(summary: Mapping[str, Any], config: Config) -> Report:
    rows = [
        {
            "preset": row["preset"], "off": f"{row['kind']} {row['size']:g}" if row["size"] else "nothing",
            "size": row["size"], "kind": row["kind"],
            **{key: f"{row[f'dcac_{key}']:.3f}/{row[f'moc_{key}']:.3f}" for key in SHOWN if f"moc_{key}" in row},
            "change": spread(row, change_name(JUDGED)),
        }
        for row in summary["calibration"] if row["size"] or row["kind"] == "origins"
    ]  # fmt: skip
    first = [{**row, "off": f"{row['preset']}, {row['size']:g}"} for row in rows if row["kind"] == "origins"]
    tip = {key: title.removeprefix("tip, ") for key, title in SHOWN.items() if title.startswith("tip")}
    table = Table(
        "Mean tip error under DCAC/MOC, with errors of the joint origins", [
            Column("off", "preset, error [mm]"),
            *(Column(key, title, unit="mm", section="Calibration errors") for key, title in tip.items()),
        ], first, "After travel: mean after the elbow's arrival. Registered again: the same mean, if the robot "
        "registers again at the arrival (computed from the same run).",
    )  # fmt: skip
    evens = [
        {**row, **{key: _at(row[key], KINDS[row["kind"]]) for key in ("relative", "absolute", "absolute_dcac")}}
        for row in summary["break_even"] if not row["undecided"]
    ]  # fmt: skip
    sections = [
        Section("Calibration errors", f"{DEFINED} {FRAMES} {BASE_FRAME}", [
            Table("Break-even", [
                Column("preset", "preset"), Column("kind", "kind of error"), Column("relative", "MOC above DCAC + 5 %"),
                Column("absolute", "MOC above 0.1 mm"), Column("absolute_dcac", "DCAC above 0.1 mm"),
            ], evens),
            Table("Mean errors under DCAC/MOC in every frame", [
                Column("preset", "preset"), Column("off", "error [mm, mrad]"),
                *(Column(key, title, unit="mm") for key, title in SHOWN.items()),
                Column("change", "change of tip, registered", unit="%"),
            ], rows),
        ]),
        *(Section(f"Defects, preset {preset}", "Means over the completed runs.", [Table(
            f"The defects alone and together, preset {preset}", [
                Column("group", "effect, controller"),
                *columns(*(["whole"] if any(row["whole"] < row["trials"] for row in groups.values()) else []), *ERRORS),
            ], [{"group": name, **row} for name, row in groups.items()])])
          for preset, groups in summary["effects"].items()),
    ]  # fmt: skip
    title = f"LWR4+: cost of the arm's defects under DCAC and MOC with {config.solver}"
    return Report(title, sentences(summary), table, pictures(summary["calibration"], config), sections)


def sentences(summary: Mapping[str, Any]) -> list[str]:
    said, evens = [], {(one["preset"], one["kind"]): one for one in summary["break_even"]}
    for preset in dict.fromkeys(preset for preset, _ in evens):
        origins, encoders = evens[preset, "origins"], evens[preset, "encoders"]
        if few := origins["undecided"] or encoders["undecided"]:
            said.append(f"Preset {preset}: {few}.")
            continue
        relative, absolute = (
            f"{_at(origins[key], 'mm')} (joint origins) or {_at(encoders[key], 'mrad')} (encoders)"
            for key in ("relative", "absolute")
        )
        text = (
            f"Preset {preset}, {origins['trials']} trials: MOC's registered tip error is surely more than "
            f"{MOST_CHANGE_PERCENT:g} % above DCAC's if the calibration error exceeds {relative}. MOC's mean "
            f"registered tip error exceeds {MOST_MM:g} mm if the calibration error exceeds {absolute}."
        )
        here = (preset, "origins", DEFAULT_SIZE_MM)
        for row in (row for row in summary["calibration"] if (row["preset"], row["kind"], row["size"]) == here):
            if "moc_tip_again_mm" in row:
                text += (
                    f" With joint origins off by {DEFAULT_SIZE_MM:g} mm, MOC's tip error is "
                    f"{row['moc_tip_after_mm']:.3f} mm after the elbow's arrival. After a new registration it is "
                    f"{row['moc_tip_again_mm']:.3f} mm (DCAC: {row['dcac_tip_again_mm']:.3f} mm)."
                )
        said.append(text)
    return said


def _at(size: float | None, unit: str) -> str:
    return "a size above all tried sizes" if size is None else f"{size:.2g} {unit}"


def pictures(rows: Sequence[Mapping[str, Any]], config: Config) -> list[Picture]:
    found = []
    keys = {"DCAC": f"dcac_{JUDGED}", "MOC": f"moc_{JUDGED}",
            "MOC after the travel, registered again": "moc_tip_again_mm"}  # fmt: skip
    for preset in config.presets:
        mine = [row for row in rows if (row["preset"], row["kind"]) == (preset, "origins")]
        lines = {
            name: [(row["size"], *at) for row in mine if (at := ends(row, key)) is not None]
            for name, key in keys.items()
        }
        drawn = lines_picture(lines, "error of the joint origins [mm]", "mean tip error, registered frame [mm]")
        rule(drawn, "y", MOST_MM, f"{MOST_MM:g} mm")
        says = f"Preset {preset}: tip error in the frame registered at the start, with 95 % intervals over the trials."
        found.append(Picture(drawn, says, f"calibration-{preset}"))
    return found


main = partial(command, "plant", "What each defect of the arm costs.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
