"""A scenario that runs on, a few ticks at a time, while solver, gains and trocar may be changed."""

from __future__ import annotations

from collections import deque
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control import Controller, ControlSettings
from moc_opt.control.settings import Gains
from moc_opt.errors import MocOptError, RobotError, ScenarioError, is_number
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.model import RobotModel, RobotState
from moc_opt.scenario import Scenario, Setup, isolated, make_solver
from moc_opt.tasks import Reference
from moc_opt.tasks.trocar import shaft_distance

DCAC = "none (DCAC)"
QUANTITIES = ("t_s", "mu", "mu_bound", "tip_error_m", "rcm_error_m", "force_N", "solve_us", "tick_us")
HISTORY_S = 20.0
BLEND_S = 0.1  # in which the difference of two controllers' torques decays; the next exchange waits for as long
RAMP_S = 0.3  # in which a new third level fades in: it pulls so hard at first that no blend of torques makes up for it
SLOWLY_M_PER_S, MOST_OFFSET_M = 0.02, 0.05  # of the trocar: a jump would be a blow
_BOUND_EVERY_TICKS = 50


class LiveError(ScenarioError):
    """A live run cannot do what it was told; it goes on as it was."""


class Moment(NamedTuple):
    """What a page shows: the arm's state, the trocar (3,) [m], the solver (or `DCAC`) and its last claim."""

    t_s: float
    state: RobotState
    trocar: Array
    solver: str
    status: str
    stopped: str  # why the arm was stopped; empty while it runs


class Choice(NamedTuple):
    """A controller, and its solver by the name that was asked for."""

    controller: Controller
    solver: str


class ExchangeableController:
    """The controller in use, as the closed loop calls it (``sim.protocols.TorqueController``).

    After an exchange tau = tau_new + offset: offset is tau_old - tau_new at first and decays by exp(-t / BLEND_S).
    The next exchange waits for BLEND_S: exchanges at every tick would hold the torque, and nobody would control the
    arm. A choice that cannot start is dropped, and its error noted in ``messages``.
    """

    def __init__(self, first: Choice, period_s: float, messages: deque[str]) -> None:
        self.used, self._messages = first, messages
        self._decay, self._apart = float(np.exp(-period_s / BLEND_S)), round(BLEND_S / period_s)
        self.next: Choice | None = None  # taken at the next tick, or BLEND_S after the last exchange
        self.lock = Lock()  # of `next`
        self._applied = np.zeros(0)

    state = property(lambda self: self.used.controller.state, doc="The model's state at the last tick.")

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Start the controller in use."""
        self._wait, self._offset = 2, np.zeros(len(q))  # no exchange at the first tick: no torque has acted yet
        self.used.controller.start(q, v, tip_ref, trocar)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of the controller in use, blended with that of the one before."""
        self._wait -= 1
        tau, choice = None, self.next
        if self._wait <= 0 and choice is not None:
            controller = choice.controller
            try:
                controller.start(q, v, tip_ref, trocar)
                controller.set_applied_torque(self._applied)
                tau = controller.tick(q, v, tip_ref, trocar)
                self.used, self._offset, self._wait = choice, self._applied - tau, self._apart
            except MocOptError as error:
                self._messages.append(f"{error}; {self.used.solver} goes on")
            with self.lock:  # another one may have been asked for meanwhile
                self.next = None if self.next is choice else self.next
        if tau is None:
            tau = self.used.controller.tick(q, v, tip_ref, trocar)
        if self._offset.any():
            tau = tau + self._offset
            self._offset = self._offset * self._decay if np.abs(self._offset).max() > 1e-6 else 0.0 * self._offset
            self.used.controller.set_applied_torque(tau)
        self._applied = tau
        return tau

    def set_applied_torque(self, tau: Array) -> None:
        """See ``sim.protocols.TorqueController``."""
        self._applied = tau
        self.used.controller.set_applied_torque(tau)


class ToAndFro:
    """A reference that goes along its path, rests, comes back the same way, rests, and so on for ever."""

    def __init__(self, reference: Reference, one_way_s: float) -> None:
        self._reference, self.one_way_s = reference, one_way_s

    def rows(self, t: float) -> Array:
        """Return X_d, dX_d, ddX_d as the rows of one (3, 3) array, at a time [s]."""
        lap, within = divmod(t, self.one_way_s)
        if int(lap) % 2 == 0:
            return self._reference.rows(within)
        return self._reference.rows(self.one_way_s - within) * [[1.0], [-1.0], [1.0]]  # backwards in time


class LiveRun:
    """The closed loop of a scenario, its path to and fro for ever; a MocOptError where the scenario is not usable.

    `advance` belongs to one thread; every other method may be called from any. A change takes effect at the next tick
    (a new controller at least 0.1 s after the one before). What is wrong with it is raised at once, or, where only the
    running loop can tell, found in `messages`, oldest first: take them out with `popleft`.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._setup = scenario, Setup(scenario)
        self.robot, self.period_s = self._setup.robot, scenario.plant.period_s
        self.reference = ToAndFro(self._setup.reference, self._setup.duration_s)
        self.messages: deque[str] = deque(maxlen=100)
        self._lock, self._building = Lock(), Lock()  # of the history, and of whoever builds a controller
        # Solvers may be built, with CasADi functions of the arm, while the loop uses its own model.
        self._workshop = RobotModel(self.robot.data)
        self._rows: deque[tuple[Any, ...]] = deque(maxlen=round(HISTORY_S / self.period_s))
        self._truth = np.empty(2 * self.robot.n + 9)
        solver = scenario.solver.name if scenario.control.law == "moc" else DCAC
        first = Choice(self._build(scenario.control, solver), solver)
        self._in_use = ExchangeableController(first, self.period_s, self.messages)
        self._asked = np.zeros(3)
        self._begin()

    # --- what may be called from anywhere ---

    # What was asked for last: of the choice that waits, or else of the one in use.
    _chosen = property(lambda self: self._in_use.next or self._in_use.used)
    control = property(lambda self: self._chosen.controller.settings, doc="The settings of the control law.")
    solver = property(lambda self: self._chosen.solver, doc="The solver, or `DCAC`.")

    @property
    def gains(self) -> Gains:
        """K_X .. D_N2 as numbers."""
        return self.control.resolve_gains(self.robot.data.gains, self.robot.n)

    def choose(self, solver: str) -> None:
        """Put another solver, or `DCAC`, into the third level; a MocOptError where it cannot run here."""
        with self._building:
            law = self.control.matched_dcac() if solver == DCAC else {"law": "moc"}
            self._exchange(self.control.replace(law), solver)

    def tune(self, **settings: Any) -> None:
        """Change settings of the control law, by the names of `ControlSettings`; a MocOptError for a wrong one."""
        with self._building:
            if "law" in settings:
                raise LiveError("law: choose(solver) decides on it")
            self._exchange(self.control.replace(settings), self.solver)

    def place_trocar(self, x_m: float, y_m: float, z_m: float = 0.0) -> None:
        """Move the trocar slowly to an offset in world axes [m] of at most `MOST_OFFSET_M`; the controller is told."""
        for value in (x_m, y_m, z_m):
            if not is_number(value) or not abs(value) <= MOST_OFFSET_M:
                raise LiveError(f"trocar offset = {value!r} m: give a number from {-MOST_OFFSET_M} to {MOST_OFFSET_M}")
        self._asked = np.array([x_m, y_m, z_m])

    def reset(self) -> None:
        """Go back to the start, with solver, gains and trocar as they are."""
        self._reset = True

    def moment(self) -> Moment:
        """Return what there is to see now."""
        return self._moment

    def history(self, points: int = 400) -> Array:
        """Return the last `HISTORY_S` seconds (k, 8), columns as `QUANTITIES`, in some `points` rows: peaks stay."""
        with self._lock:
            rows = np.array(self._rows).reshape(-1, len(QUANTITIES))
        size = max(1, -(-len(rows) // points))
        stretches = rows[len(rows) % size :].reshape(-1, size, len(QUANTITIES))  # the oldest few are left out
        return np.fmax.reduce(stretches, axis=1)

    # --- what the loop's own thread calls ---

    def advance(self, ticks: int) -> None:
        """Reset if that was asked for, and run so many ticks, none while the arm is stopped."""
        try:
            if self._reset:
                self._begin()
            for _ in range(ticks):
                if not self._stopped:
                    self._tick()
        except MocOptError as error:
            self._halt(str(error))

    def _begin(self) -> None:
        self._reset, self._stopped, self._bound, self._offset = False, "", np.nan, np.zeros(3)
        self._setup.plant.reset(self._setup.q_start)
        self._loop = self._setup.closed_loop(self._in_use)
        self._move_trocars()
        self._loop.start(self.reference.rows(0.0), self._now[1])
        with self._lock:
            self._rows.clear()
        self._show(0.0, self._in_use.state, self._now[0][0])

    def _tick(self) -> None:
        t, (trocar, registered) = self._t, self._now
        tip_ref = self.reference.rows(t)
        self._setup.plant.write_truth(self._truth)
        self._loop.step(tip_ref, registered, trocar)
        state, controller = self._in_use.state, self._in_use.used.controller
        tip, wrist, force = self._truth[2 * self.robot.n :].reshape(3, 3)
        if self._loop.ticks % _BOUND_EVERY_TICKS == 1:
            try:
                self._bound = self_motion(self.robot, np.clip(state.q, self.robot.q_min, self.robot.q_max), 0.1).mu_best
            except RobotError:
                self._bound = float("nan")  # a singular pose: no single curve leads through it
        errors = np.linalg.norm(tip - tip_ref[0]), shaft_distance(tip, wrist, trocar[0]), np.linalg.norm(force)
        with self._lock:
            self._rows.append((t, state.mu, self._bound, *errors, controller.solve_us, self._loop.tick_us))
        self._show(t, state, trocar[0])
        self._move_trocars()
        if self._loop.finished:
            self._halt(self._loop.stop_reason)

    @property
    def _t(self) -> float:
        return self._loop.ticks * self.period_s

    def _move_trocars(self) -> None:
        """Set rows (2, 3) P_t, dP_t of the true and the registered trocar for the period that begins now."""
        away, most = self._asked - self._offset, SLOWLY_M_PER_S * self.period_s
        shift = away * min(1.0, most / max(float(np.linalg.norm(away)), 1e-12))
        moved = np.array([self._offset, shift / self.period_s])
        self._now = tuple(trocar.rows(self._t) + moved for trocar in (self._setup.trocar, self._setup.registered))
        self._offset = self._offset + shift

    def _show(self, t: float, state: RobotState, trocar: Array) -> None:
        used = self._in_use.used
        status = "none" if used.controller.solution is None else used.controller.solution.status.label
        self._moment = Moment(t, state, np.array(trocar), used.solver, status, self._stopped)

    def _halt(self, reason: str) -> None:
        self._stopped = f"stopped at {self._t:.2f} s: {reason}"
        self.messages.append(f"{self._stopped}; change what caused it and reset")
        self._show(self._t, self._moment.state, self._moment.trocar)

    def _build(self, control: ControlSettings, name: str) -> Controller:
        if control.follows:
            raise LiveError(
                f"[control] third_level = {control.third_level!r}: a live run goes to and fro for ever, and a course "
                "ends with its path; take third_level = 'local'"
            )
        settings = self.scenario.solver.settings if name == self.scenario.solver.name else {}
        solver = None if name == DCAC else isolated(make_solver(name, self._workshop, **settings), self.scenario)
        return Controller(self.robot, control, solver, self.period_s)

    def _exchange(self, control: ControlSettings, name: str) -> None:
        gently = control.model_copy(update={"ramp_s": max(control.ramp_s, RAMP_S)})
        choice = Choice(self._build(gently, name), name)
        with self._in_use.lock:
            self._in_use.next = choice
