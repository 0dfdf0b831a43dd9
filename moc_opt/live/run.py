"""An endless run of a scenario. Solver, gains and trocar can be changed during the run."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control import Controller, ControlSettings
from moc_opt.errors import MocOptError, ScenarioError, is_number
from moc_opt.scenario import Scenario, Setup, isolated, make_solver
from moc_opt.tasks.trocar import shaft_distance

DCAC = "none (DCAC)"
QUANTITIES = ("t_s", "mu", "tip_error_m", "rcm_error_m", "force_N", "solve_us", "tick_us")
HISTORY_S = 20.0  # length of the kept history [s]
BLEND_S = 0.1  # time constant of the torque's blend, and least time between two exchanges [s]
RAMP_S = 0.3  # least `ramp_s` of a new controller [s]
TROCAR_SPEED_M_PER_S, MOST_OFFSET_M = 0.02, 0.05  # limits when the user moves the trocar


class LiveError(ScenarioError):
    """A live run cannot carry out an order."""


class ExchangeableController:
    """A ``sim.protocols.TorqueController`` that passes each call to an exchangeable controller.

    The controller in ``next`` waits until BLEND_S has passed since the previous exchange, and then takes over. A time
    t after this exchange, the torque is tau_new + jump exp(-t / BLEND_S). ``jump`` is the last torque before the
    exchange minus the new controller's first torque.
    """

    def __init__(self, first: Controller, period_s: float, messages: deque[str]) -> None:
        self.used, self._messages = first, messages
        self._decay, self._apart = float(np.exp(-period_s / BLEND_S)), round(BLEND_S / period_s)
        self.next: Controller | None = None
        self._applied = np.zeros(0)

    state = property(lambda self: self.used.state, doc="The model's state at the last tick.")

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Start the controller in use."""
        self._wait, self._offset = 2, np.zeros(len(q))  # 2: no exchange at the first tick
        self.used.start(q, v, tip_ref, trocar)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Return the blended torque (n,) [Nm]."""
        self._wait -= 1
        tau, new = None, self.next
        if self._wait <= 0 and new is not None:
            self.next = None
            try:
                new.start(q, v, tip_ref, trocar)
                new.set_applied_torque(self._applied)
                tau = new.tick(q, v, tip_ref, trocar)
                self.used, self._offset, self._wait = new, self._applied - tau, self._apart
            except MocOptError as error:
                self._messages.append(f"{error}; {solver_of(self.used)} stays in use")
        if tau is None:
            tau = self.used.tick(q, v, tip_ref, trocar)
        if self._offset.any():
            tau = tau + self._offset
            self._offset = self._offset * self._decay if np.abs(self._offset).max() > 1e-6 else 0.0 * self._offset
            self.used.set_applied_torque(tau)
        self._applied = tau
        return tau

    def set_applied_torque(self, tau: Array) -> None:
        """See ``sim.protocols.TorqueController``."""
        self._applied = tau
        self.used.set_applied_torque(tau)


def solver_of(controller: Controller) -> str:
    """Return the solver's name, or `DCAC`."""
    return DCAC if controller.solver is None else controller.solver.name


class LiveRun:
    """The closed loop of a scenario, in which the arm moves to and fro along the path. Use it from one thread only.

    An unusable scenario raises a MocOptError. Errors of the running loop are put into `messages`. ``stopped`` says why
    the arm stopped.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._setup = scenario, Setup(scenario)
        self.robot, self.period_s = self._setup.robot, scenario.plant.period_s
        self.path = np.array([self.rows(float(t))[0] for t in np.linspace(0.0, self._setup.duration_s, 300)])
        self.messages: deque[str] = deque(maxlen=100)
        self._rows: deque[tuple[Any, ...]] = deque(maxlen=round(HISTORY_S / self.period_s))
        self._truth, self._asked = np.empty(2 * self.robot.n + 9), np.zeros(3)
        solver = scenario.solver.name if scenario.control.law == "moc" else DCAC
        self._in_use = ExchangeableController(self._build(scenario.control, solver), self.period_s, self.messages)
        self.reset()

    state = property(lambda self: self._in_use.state, doc="The model's state at the last tick.")
    used = property(lambda self: self._in_use.used, doc="The controller in use.")
    trocar = property(lambda self: self._now[0][0], doc="Position of the true trocar (3,) [m] in the next tick.")
    _chosen = property(lambda self: self._in_use.next or self._in_use.used)
    control = property(lambda self: self._chosen.settings, doc="Settings of the waiting controller, or else of `used`.")
    solver = property(lambda self: solver_of(self._chosen), doc="Name of that controller's solver, or `DCAC`.")

    def choose(self, solver: str) -> None:
        """Switch to a solver or `DCAC`. Raises a MocOptError if the solver cannot run."""
        law = self.control.matched_dcac() if solver == DCAC else {"law": "moc"}
        self._exchange(self.control.change(**law), solver)

    def tune(self, **settings: Any) -> None:
        """Change settings of `ControlSettings` by name. Raises a MocOptError if a name or value is wrong."""
        if "law" in settings:
            raise LiveError("law cannot be set here: choose(solver) sets it")
        self._exchange(self.control.change(**settings), self.solver)

    def _exchange(self, control: ControlSettings, name: str) -> None:
        gently = control.model_copy(update={"ramp_s": max(control.ramp_s, RAMP_S)})
        self._in_use.next = self._build(gently, name)

    def _build(self, control: ControlSettings, name: str) -> Controller:
        if control.follows:
            raise LiveError(
                f"[control] third_level = {control.third_level!r}: a planned joint motion ends where the path ends, "
                "but a live run goes to and fro along the path; use third_level = 'local'"
            )
        settings = self.scenario.solver.settings if name == self.scenario.solver.name else {}
        solver = None if name == DCAC else isolated(make_solver(name, self.robot, **settings), self.scenario)
        return Controller(self.robot, control, solver, self.period_s)

    def place_trocar(self, x_m: float, y_m: float, z_m: float = 0.0) -> None:
        """Move the trocar slowly to an offset, of at most `MOST_OFFSET_M` along each world axis."""
        for value in (x_m, y_m, z_m):
            if not is_number(value) or not abs(value) <= MOST_OFFSET_M:
                raise LiveError(f"trocar offset = {value!r} m: give a number from {-MOST_OFFSET_M} to {MOST_OFFSET_M}")
        self._asked = np.array([x_m, y_m, z_m])

    def rows(self, t: float) -> Array:
        """Return the tip's reference, rows X_d, dX_d, ddX_d (3, 3), at a time [s]."""
        lap, within = divmod(t, self._setup.duration_s)
        if int(lap) % 2 == 0:
            return self._setup.reference.rows(within)
        return self._setup.reference.rows(self._setup.duration_s - within) * [[1.0], [-1.0], [1.0]]  # backwards

    def history(self, points: int = 400) -> Array:
        """Return the maxima (k, 7) of `QUANTITIES` in k <= ``points`` groups of past ticks."""
        rows = np.array(self._rows).reshape(-1, len(QUANTITIES))
        size = max(1, -(-len(rows) // points))
        stretches = rows[len(rows) % size :].reshape(-1, size, len(QUANTITIES))  # drops the incomplete oldest group
        return np.fmax.reduce(stretches, axis=1)

    def reset(self) -> None:
        """Go back to the start. Solver, gains and the trocar's requested offset stay."""
        self.t_s, self.stopped, self._offset = 0.0, "", np.zeros(3)
        self._setup.plant.reset(self._setup.q_start)
        self._loop = self._setup.closed_loop(self._in_use)
        self._move_trocars()
        self._loop.start(self.rows(0.0), self._now[1])
        self._rows.clear()

    def advance(self, ticks: int) -> None:
        """Run ``ticks`` ticks, or fewer if the arm stops."""
        try:
            for _ in range(ticks):
                if not self.stopped:
                    self._tick()
        except MocOptError as error:
            self._halt(str(error))

    def _tick(self) -> None:
        self.t_s, (trocar, registered) = self._loop.ticks * self.period_s, self._now
        tip_ref = self.rows(self.t_s)
        self._setup.plant.write_truth(self._truth)
        self._loop.step(tip_ref, registered, trocar)
        tip, wrist, force = self._truth[2 * self.robot.n :].reshape(3, 3)
        errors = np.linalg.norm(tip - tip_ref[0]), shaft_distance(tip, wrist, trocar[0]), np.linalg.norm(force)
        self._rows.append((self.t_s, self.state.mu, *errors, self.used.solve_us, self._loop.tick_us))
        self._move_trocars()
        if self._loop.finished:
            self._halt(self._loop.stop_reason)

    def _move_trocars(self) -> None:
        t = self._loop.ticks * self.period_s
        away, most = self._asked - self._offset, TROCAR_SPEED_M_PER_S * self.period_s
        shift = away * min(1.0, most / max(float(np.linalg.norm(away)), 1e-12))
        moved = np.array([self._offset, shift / self.period_s])
        self._now = tuple(trocar.rows(t) + moved for trocar in (self._setup.trocar, self._setup.registered))
        self._offset = self._offset + shift

    def _halt(self, reason: str) -> None:
        self.stopped = f"stopped at {self._loop.ticks * self.period_s:.2f} s: {reason}"
        self.messages.append(f"{self.stopped}; remove the cause, then reset")
