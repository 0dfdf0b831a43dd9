"""The controls of the live page: send input to the run, and show its answers."""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock
from typing import Any

import numpy as np

from moc_opt import solvers
from moc_opt.errors import MocOptError
from moc_opt.inputs.names import in_markdown
from moc_opt.live.history import QUANTITIES
from moc_opt.live.orders import DCAC, LiveError, Moment
from moc_opt.live.run import LiveRun

COLUMN = {name: k for k, name in enumerate(QUANTITIES)}
BLUE, ORANGE, GREEN, MUTED = "#0072b2", "#d55e00", "#009e73", "#77787b"
PLOTS: dict[str, list[tuple[str, str, float, str]]] = {
    "µ and the largest on its self-motion curve [m³]": [("mu", "µ", 1.0, BLUE), ("mu_bound", "largest", 1.0, MUTED)],
    "RCM error, tip error in space [mm]": [("rcm_error_m", "RCM", 1e3, BLUE), ("tip_error_m", "tip", 1e3, ORANGE)],
    "force of the trocar [N]": [("force_N", "force", 1.0, BLUE)],
    "whole tick, solver [µs]": [("tick_us", "tick", 1.0, BLUE), ("solve_us", "solver", 1.0, GREEN)],
}
"""Title -> (quantity, name, factor to the unit shown, colour)."""
FIELDS = {
    "regularization": ("ρ", "weight of |x|² in the subproblem; 0 is the paper's linear problem"),
    "K_X": ("K_X [N/m]", "tip stiffness"),
    "K_N": ("K_N [N/m]", "wrist stiffness"),
    "K_N2": ("K_N2 [N m s/rad]", "third level, on x* - v; one number, or one per joint"),
    "D_N2": ("D_N2 [N m s/rad]", "third level, on v; one number, or one per joint"),
    "k0_per_s": ("k0 [1/s]", "velocity damper at the joint limits"),
}
"""Setting of the control law -> its label and its meaning."""


class Panel:
    """The side panel.

    Attributes:
        paused: whether the user has stopped the clock.
    """

    def __init__(self, server: Any, run: LiveRun) -> None:
        """Build it; `server` is a viser.ViserServer."""
        self._server, self._run, gui = server, run, server.gui
        self.paused = False
        self._doing = RLock()  # viser calls back from many threads, in any order; setting a value calls back too
        self._status = gui.add_markdown("starting")
        choices = [DCAC, *(name for name, reason in solvers.available().items() if reason is None)]
        self._solver = gui.add_dropdown("Solver", choices, initial_value=run.moment().solver)
        self._solver.on_update(lambda _: self._do(self._choose))
        self._plots = [gui.add_uplot(**_empty(title, lines)) for title, lines in PLOTS.items()]
        with gui.add_folder("Elbow"):
            self._force = gui.add_slider("Push [N]", min=5.0, max=60.0, step=5.0, initial_value=30.0)
            push = gui.add_button_group("Direction", ("−", "+"))
            push.on_click(
                lambda _: self._do(lambda: run.push_elbow(self._force.value * (1.0 if push.value == "+" else -1.0)))
            )
        with gui.add_folder("Trocar"):
            place = [gui.add_slider(f"{axis} [mm]", min=-40.0, max=40.0, step=1.0, initial_value=0.0) for axis in "xyz"]
            for slider in place:
                slider.on_update(lambda _: self._do(lambda: run.place_trocar(*(1e-3 * s.value for s in place))))
            trocar = run.scenario.trocar
            breath = gui.add_slider(
                "breathing [mm]", min=0.0, max=30.0, step=0.5,
                initial_value=min(1e3 * trocar.breathing_amplitude_m, 30.0),
            )  # fmt: skip
            period = gui.add_slider(
                "one breath [s]", min=1.0, max=10.0, step=0.1,
                initial_value=float(np.clip(trocar.breathing_period_s, 1.0, 10.0)),
            )  # fmt: skip
            for slider in (breath, period):
                slider.on_update(lambda _: self._do(lambda: run.breathe(1e-3 * breath.value, period.value)))
        with gui.add_folder("Weights and gains"):
            self._fields = {
                name: gui.add_text(label, self._written(name), hint=hint) for name, (label, hint) in FIELDS.items()
            }
            gui.add_button("Apply").on_click(lambda _: self._do(self._apply))
        pause = gui.add_checkbox("Pause", initial_value=False)
        pause.on_update(lambda _: setattr(self, "paused", pause.value))
        gui.add_button("Reset to the start").on_click(lambda _: run.reset())

    def _choose(self) -> None:
        """Request the present choice of the list, which may be later than the change that called."""
        if self._solver.value != self._run.solver:  # it may have been set back, not chosen
            self._run.choose(self._solver.value)

    def _written(self, name: str) -> str:
        value = getattr(self._run.gains, name, None)
        if value is None:
            value = getattr(self._run.control, name)
        numbers = [f"{number:g}" for number in np.atleast_1d(value)]
        return numbers[0] if len(set(numbers)) == 1 else " ".join(numbers)

    def _apply(self) -> None:
        """Take all fields at once: half of a change would be another controller."""
        values: dict[str, Any] = {}
        for name, field in self._fields.items():
            if field.value.strip() == self._written(name):
                continue  # what nobody has changed stays what it is, digits that are not shown included
            try:
                numbers = tuple(float(number) for number in field.value.replace(",", ".").split())
                values[name] = numbers if len(numbers) > 1 else numbers[0]
            except (ValueError, IndexError) as error:
                raise LiveError(
                    f"{FIELDS[name][0]} = {field.value!r}: give a number (the third level also takes one per joint, "
                    "with spaces between)"
                ) from error
        if values:
            self._run.tune(**values)

    def _do(self, act: Callable[[], None]) -> None:
        """Do what the user wants, or say what is wrong with it; the run goes on either way."""
        with self._doing:
            try:
                act()
            except MocOptError as error:
                self.tell(str(error))
                self._solver.value = self._run.solver
                for name, field in self._fields.items():
                    field.value = self._written(name)

    def tell(self, text: str) -> None:
        """Show a message on every open page."""
        for client in self._server.get_clients().values():
            client.add_notification("This cannot be done", text[:600], color="red", auto_close_seconds=12)

    def update(self, moment: Moment, pace: float) -> None:
        """Show the run as it is; `pace` is simulated over real time."""
        while self._run.messages:
            self.tell(self._run.messages.popleft())
            self._solver.value = self._run.solver
        rows = self._run.history(300)
        if len(rows) < 2:
            return
        for plot, lines in zip(self._plots, PLOTS.values(), strict=True):
            plot.data = (rows[:, 0], *(factor * rows[:, COLUMN[name]] for name, _, factor, _ in lines))
        last = rows[-1]
        self._status.content = in_markdown(moment.stopped) or (
            f"**{moment.solver}** · {moment.status} · {moment.t_s:.1f} s, real time × {pace:.2f}"
            f"{' · paused' if self.paused else ''}  \n"
            f"µ {last[COLUMN['mu']]:.3f} m³ · RCM {1e3 * last[COLUMN['rcm_error_m']]:.2f} mm · "
            f"force {last[COLUMN['force_N']]:.1f} N · tick {last[COLUMN['tick_us']]:.0f} µs"
        )


def _empty(title: str, lines: list[tuple[str, str, float, str]]) -> dict[str, Any]:
    """Return a plot without a point yet."""
    series = [{"label": "t [s]"}, *({"label": name, "stroke": color, "width": 1.5} for _, name, _, color in lines)]
    nothing = np.array([0.0, 1.0])
    scales: dict[str, Any] = {"x": {"time": False}}
    grid = {"stroke": "#e3e6e9", "width": 1}
    axis = {"grid": grid, "ticks": {"show": False}}
    vertical: dict[str, Any] = {**axis, "size": 56}
    if "µs" in title:  # one long tick must not flatten all the others
        scales["y"] = {"distr": 3, "log": 10}
        vertical["grid"] = {"show": False}  # it would have nine lines a decade
    return {
        "data": (nothing, *(np.full(2, np.nan) for _ in lines)), "series": tuple(series), "title": title, "height": 140,
        "scales": scales, "axes": (axis, vertical), "legend": {"show": len(lines) > 1},
    }  # fmt: skip
