"""A scenario that runs on, a few ticks at a time, while everything about it may be changed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Lock
from typing import Any

import numpy as np

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.gains import Gains
from moc_opt.errors import MocOptError, RobotError
from moc_opt.live.exchange import Choice, ExchangeableController
from moc_opt.live.history import History, thinned
from moc_opt.live.motion import MovingTrocars, ToAndFro
from moc_opt.live.orders import (
    DCAC,
    LiveError,
    Moment,
    changed,
    check_breathing,
    check_push,
    checked_offset,
    child_link,
)
from moc_opt.model.robot_model import RobotModel, RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.arm_angle import Elbow
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.scenario import Scenario, Setup, make_solver
from moc_opt.scenario.parts import isolated
from moc_opt.tasks.trocar import shaft_distance

RAMP_S = 0.3
"""Least time in which the third level of a new controller fades in: it pulls so hard at first, and so shortly, that
no blend of the torques makes up for it."""
BOUND_EVERY_TICKS = 50
HISTORY_S = 20.0


class LiveRun:
    """The closed loop of a scenario, its path to and fro for ever.

    `advance` belongs to one thread; every other method may be called from any. What they change takes effect at
    the next tick (a new controller at least 0.1 s after the one before), and what is wrong with it is raised at once,
    or, where only the running loop can tell, found in `messages`.

    Attributes:
        one_way_s: time from one end of the path to the other, rests included [s].
        messages: errors, oldest first; take them out with `popleft`.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build everything, at rest at its start.

        Raises:
            MocOptError: the scenario is not usable.
        """
        self.scenario = scenario
        self._setup = Setup(scenario)
        self.robot, self.period_s = self._setup.robot, scenario.plant.period_s
        self.reference = ToAndFro(self._setup.reference, self._setup.duration_s)
        self.one_way_s = self._setup.duration_s
        self.messages: deque[str] = deque(maxlen=100)
        self._todo: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._lock, self._building = Lock(), Lock()
        # Solvers may be built, with CasADi functions of the arm, while the loop uses its own model.
        self._workshop = RobotModel(self.robot.data)
        self._control = scenario.control.model_copy(update={"backend": "python"})
        self._name = scenario.solver.name if scenario.control.law == "moc" else DCAC
        self._history = History(round(HISTORY_S / self.period_s))
        wrist = self.robot.state(self._setup.q_start).wrist
        self._elbow = Elbow(self.robot, wrist[None])
        self._elbow_link = child_link(self.robot, self._elbow.joint)
        self._truth = np.empty(2 * self.robot.n + 9)
        first = Choice(self._build(self._control, self._name), self._name, self._control)
        self._in_use = ExchangeableController(self.robot, first, self.period_s, self._refused)
        self._trocars = MovingTrocars(self._setup.trocar, self._setup.registered, scenario.trocar.breathing_known)
        self._begin()

    # --- what may be called from anywhere ---

    @property
    def control(self) -> ControlSettings:
        """The settings that were asked for last."""
        return self._control

    @property
    def solver(self) -> str:
        """The solver that was asked for last, or `DCAC`."""
        return self._name

    @property
    def gains(self) -> Gains:
        """K_X .. D_N2 as numbers."""
        return self._control.resolve_gains(self.robot.data.gains, self.robot.n)

    def choose(self, solver: str) -> None:
        """Put another solver, or `DCAC`, into the third level.

        Raises:
            MocOptError: it does not exist, or cannot run here.
        """
        with self._building:
            law = self._control.matched_dcac() if solver == DCAC else {"law": "moc"}
            self._exchange(changed(self._control, **law), solver)

    def tune(self, **settings: Any) -> None:
        """Change settings of the control law, by the names of `ControlSettings`.

        Raises:
            UnknownNameError: a name that does not exist.
            ControlError: a value out of range.
        """
        with self._building:
            if "law" in settings or "backend" in settings:
                raise LiveError("law, backend: choose(solver) decides on the law; a live run computes in Python")
            self._exchange(changed(self._control, **settings), self._name)

    def place_trocar(self, x_m: float, y_m: float, z_m: float = 0.0) -> None:
        """Move the trocar away from where it was, world axes [m]: slowly, and the controller is told.

        Raises:
            LiveError: farther than `MOST_OFFSET_M`.
        """
        offset = checked_offset(x_m, y_m, z_m)
        self._todo.put(lambda: self._trocars.move(offset=offset))

    def breathe(self, amplitude_m: float, period_s: float) -> None:
        """Set amplitude [m] and period [s] of the trocar's breathing.

        Raises:
            LiveError: out of range.
        """
        check_breathing(amplitude_m, period_s)
        self._todo.put(lambda: self._trocars.move(amplitude=amplitude_m, period_s=period_s))

    def push_elbow(self, force_N: float, seconds: float = 0.3) -> None:
        """Push the elbow along its swivel, against it where the force is negative.

        Raises:
            LiveError: out of range.
        """
        check_push(force_N, seconds)
        self._todo.put(lambda: self._push(force_N, seconds))

    def reset(self) -> None:
        """Go back to the start, with solver, gains and trocar as they are."""
        self._todo.put(self._begin)

    def moment(self) -> Moment:
        """Return what there is to see now."""
        with self._lock:
            return self._moment

    def history(self, points: int = 400) -> Array:
        """Return the last `HISTORY_S` seconds (k, 8), columns as in `history.QUANTITIES`, at most `points` rows.

        Raises:
            LiveError: points is no whole number, 1 or more.
        """
        if not isinstance(points, int) or isinstance(points, bool) or points < 1:
            raise LiveError(f"points = {points!r}: give a whole number, 1 or more")
        with self._lock:
            rows = self._history.latest()
        return thinned(rows, points)

    # --- the loop's own thread ---

    def advance(self, ticks: int) -> None:
        """Run so many ticks, none while the arm is stopped; orders are carried out in either case."""
        for _ in range(max(ticks, 1)):
            self._obey()
            if self._stopped or ticks == 0:
                return
            try:
                self._tick()
            except MocOptError as error:
                self._halt(str(error))

    def _obey(self) -> None:
        while True:
            try:
                order = self._todo.get_nowait()
            except Empty:
                return
            try:
                order()
            except MocOptError as error:
                self.messages.append(str(error))

    def _begin(self) -> None:
        self._setup.plant.reset(self._setup.q_start)
        self._trocars.restart()
        self._in_use.restart()
        self._push_until, self._stopped, self._bound = -1, "", np.nan
        self._now = self._trocars.step(self.period_s)
        tip_ref = self.reference.rows(0.0)
        self._loop = self._setup.closed_loop(self._in_use)
        self._loop.start(tip_ref, self._now[1])
        with self._lock:
            self._history.clear()
        self._show(tip_ref[0], self._now[0][0])

    def _tick(self) -> None:
        t, plant = self._t, self._setup.plant
        tip_ref, (trocar, registered) = self.reference.rows(t), self._now
        plant.write_truth(self._truth)
        self._loop.step(tip_ref, registered, trocar)
        self._note(t, tip_ref[0], trocar[0])
        self._now = self._trocars.step(self.period_s)
        if self._loop.ticks == self._push_until:
            plant.clear_pushes(self._elbow_link)
        if self._loop.finished:
            self._halt(self._loop.stop_reason)

    @property
    def _t(self) -> float:
        return self._loop.ticks * self.period_s

    def _refused(self, choice: Choice, error: MocOptError) -> None:
        """Say that a choice cannot start, and take back that it was asked for, unless another one was since."""
        _, name, control = self._in_use.used
        with self._lock:
            if choice.settings is self._control:
                self._name, self._control = name, control
        self.messages.append(f"{error}; {name} goes on")

    def _note(self, t: float, tip_ref: Array, trocar: Array) -> None:
        n, state, controller = self.robot.n, self._in_use.state, self._in_use.used.controller
        tip, wrist, force = self._truth[2 * n :].reshape(3, 3)
        if self._loop.ticks % BOUND_EVERY_TICKS == 1:
            self._bound = self._largest_mu(state.q)
        with self._lock:
            self._history.add(
                t_s=t, mu=state.mu, mu_bound=self._bound, tip_error_m=float(np.linalg.norm(tip - tip_ref)),
                rcm_error_m=float(shaft_distance(tip, wrist, trocar)), force_N=float(np.linalg.norm(force)),
                solve_us=controller.solve_us, tick_us=self._loop.tick_us,
            )  # fmt: skip
        self._show(tip_ref, trocar, t)

    def _largest_mu(self, q: Array) -> float:
        try:
            return self_motion(self.robot, np.clip(q, self.robot.q_min, self.robot.q_max), 0.1).mu_best
        except RobotError:
            return float("nan")  # a singular pose: no single curve leads through it

    def _show(self, tip_ref: Array, trocar: Array, t: float = 0.0, state: RobotState | None = None) -> None:
        used = self._in_use.used
        solution, state = used.controller.solution, self._in_use.state if state is None else state
        status = "none" if solution is None else solution.status.label
        moment = Moment(
            t_s=t, q=state.q, tip=state.tip, tip_ref=np.array(tip_ref), trocar=np.array(trocar), J_tip=state.J_tip,
            mu=state.mu, solver=used.solver, status=status, stopped=self._stopped,
        )  # fmt: skip
        with self._lock:
            self._moment = moment

    def _halt(self, reason: str) -> None:
        self._stopped = f"stopped at {self._t:.2f} s: {reason}"
        self.messages.append(f"{self._stopped}; change what caused it and reset")
        seen = self._moment
        self._show(seen.tip_ref, seen.trocar, self._t, self.robot.state(seen.q))

    def _push(self, force_N: float, seconds: float) -> None:
        plant = self._setup.plant
        plant.push(self._elbow_link, force_N * self._elbow.direction(plant.q))
        self._push_until = self._loop.ticks + max(1, round(seconds / self.period_s))

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
        choice = Choice(self._build(gently, name), name, control)
        with self._lock:
            self._control, self._name = control, name
            self._todo.put(lambda: self._in_use.replace(choice))
