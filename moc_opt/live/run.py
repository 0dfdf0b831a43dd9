"""A scenario that runs on, a few ticks at a time, while everything about it may be changed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Lock
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.settings import Gains
from moc_opt.errors import MocOptError, RobotError
from moc_opt.live.history import History, thinned
from moc_opt.live.motion import MovingTrocar, ToAndFro
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
from moc_opt.redundancy.arm_angle import Elbow
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.scenario import Safe, Scenario, Setup, make_safety_filter, make_solver, make_stop
from moc_opt.tasks.trocar import shaft_distance

Array = NDArray[np.float64]

BLEND_S = 0.1
"""Time constant in which the difference of two controllers' torques dies away after an exchange."""
RAMP_S = 0.3
"""Time in which the third level of a new controller fades in, where its settings do not say longer: it pulls so hard
at first, and so shortly, that no blend could make up for it."""
BOUND_EVERY_TICKS = 50
HISTORY_S = 20.0


class LiveRun:
    """The closed loop of a scenario, its path to and fro for ever.

    `advance` belongs to one thread; every other method may be called from any. What they change takes effect at
    the next tick, and what is wrong with it is raised at once, or, where only the running loop can tell, found
    in `messages`.

    Attributes:
        one_way_s: time from one end of the path to the other, rests included [s].
        messages: what went wrong, oldest first; take them out with `popleft`.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build everything, at rest at its start.

        Raises:
            MocOptError: what is wrong with the scenario.
        """
        self.scenario = scenario
        self._setup = Setup(scenario)
        self.robot, self._plant = self._setup.robot, self._setup.plant
        self.period_s = scenario.plant.period_s
        self.reference = ToAndFro(self._setup.reference, self._setup.duration_s)
        self.one_way_s = self._setup.duration_s
        self.messages: deque[str] = deque(maxlen=100)
        self._todo: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._lock, self._building = Lock(), Lock()
        # Solvers may be built, with CasADi functions of the arm, while the loop uses its own model.
        self._workshop = RobotModel(self.robot.data)
        self._control = scenario.control.model_copy(update={"backend": "python"})
        self._name = scenario.solver.name if scenario.control.law == "moc" else DCAC
        self._history = History(round(HISTORY_S / self.period_s))
        wrist = self.robot.state(self._setup.q_start).wrist
        self._elbow = Elbow(self.robot, wrist[None])
        self._elbow_link = child_link(self.robot, self._elbow.joint)
        self._guard, self._stop = make_safety_filter(self.robot, scenario), make_stop(scenario)
        self._truth = np.empty(2 * self.robot.n + 9)
        self._controller, self._used = self._build(self._control, self._name), (self._name, self._control)
        self._waiting: tuple[Controller, tuple[str, ControlSettings]] | None = None
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
                raise LiveError(
                    "law, backend: choose(solver) decides on the law; a live run computes in Python"
                )
            self._exchange(changed(self._control, **settings), self._name)

    def place_trocar(self, x_m: float, y_m: float, z_m: float = 0.0) -> None:
        """Move the trocar away from where it was, world axes [m]; it goes slowly, and the controller knows.

        Raises:
            LiveError: farther than `MOST_OFFSET_M`.
        """
        offset = checked_offset(x_m, y_m, z_m)
        self._todo.put(lambda: self._move_trocar(offset=offset))

    def breathe(self, amplitude_m: float, period_s: float) -> None:
        """Let the trocar breathe.

        Raises:
            LiveError: out of range.
        """
        check_breathing(amplitude_m, period_s)
        self._todo.put(lambda: self._move_trocar(amplitude=amplitude_m, period_s=period_s))

    def push_elbow(self, force_N: float, seconds: float = 0.3) -> None:
        """Push the elbow along its swivel, against it where the force is negative.

        Raises:
            LiveError: out of range.
        """
        check_push(force_N, seconds)
        self._todo.put(lambda: self._push(force_N, seconds))

    def reset(self) -> None:
        """Back to the start, with solver, gains and trocar as they are."""
        self._todo.put(self._begin)

    def moment(self) -> Moment:
        """What there is to see now."""
        with self._lock:
            return self._moment

    def history(self, points: int = 400) -> Array:
        """The last `HISTORY_S` seconds (k, 8), columns as in `history.QUANTITIES`, at most `points` rows."""
        with self._lock:
            rows = self._history.latest()
        return thinned(rows, points)

    # --- the loop's own thread ---

    def advance(self, ticks: int) -> None:
        """Run so many ticks; none while the arm is stopped, but what was ordered is still done."""
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
        self._plant.reset(self._setup.q_start)
        old = getattr(self, "_trocar", None)
        self._trocar, self._registered = (
            MovingTrocar(self._setup.trocar),
            MovingTrocar(self._setup.registered),
        )
        if old is not None:
            self._move_trocar(old.offset, old.amplitude, old.period_s)
        self._ticks, self._push_until, self._stopped, self._bound = 0, -1, "", np.nan
        self._offset, self._sent = np.zeros(self.robot.n), np.array(self._plant.applied_torque)
        self._waiting = self._waiting or (self._controller, self._used)
        self._now = self._trocar.step(self.period_s), self._registered.step(self.period_s)
        seen, tip_ref = self._plant.measure(), self.reference.rows(0.0)
        self._safe, self._halt_at = Safe(_LiveController(self), self._guard, self._sent), -1
        self._safe.start(seen, tip_ref, self._now[1])
        state = self._state = self.robot.state(seen.q, seen.v)
        with self._lock:
            self._history.clear()
        self._show(state, tip_ref[0], self._now[0][0])

    def _tick(self) -> None:
        seen, t = self._plant.measure(), self._ticks * self.period_s
        tip_ref, (trocar, registered) = self.reference.rows(t), self._now
        begin = perf_counter_ns()
        self._sent = self._safe.tick(seen, tip_ref, registered)
        tick_us = (perf_counter_ns() - begin) * 1e-3
        if self._safe.lost:
            self._plant.brake(self._stop.damping, self._safe.hold(seen))
        if self._safe.lost and self._halt_at < 0:
            self._halt_at = self._ticks + round(self._stop.seconds / self.period_s)
        self._fade()
        self._plant.write_truth(self._truth)
        self._note(t, self._state, tip_ref[0], trocar[0], tick_us)
        self._plant.step(self._sent, trocar)
        self._ticks += 1
        self._now = self._trocar.step(self.period_s), self._registered.step(self.period_s)
        if self._ticks == self._push_until:
            self._plant.clear_pushes(self._elbow_link)
        if self._ticks == self._halt_at:
            self._halt(self._safe.lost)

    def _asked(self, q: Array, v: Array, tip_ref: Array, registered: Array) -> Array:
        """The torque of the controller in use, blended with that of the one before."""
        state = self._state = self.robot.state(q, v)
        if self._waiting is not None:
            self._take_over(*self._waiting, state, tip_ref, registered)
        asked = self._controller.tick(state, tip_ref, registered)
        if not self._offset.any():
            return asked
        asked = asked + self._offset
        self._controller.set_applied_torque(asked)
        return asked

    def _take_over(
        self,
        controller: Controller,
        asked: tuple[str, ControlSettings],
        state: RobotState,
        tip_ref: Array,
        trocar: Array,
    ) -> None:
        """Exchange the controller; the torque goes on where it was, and to the new one's within `BLEND_S`."""
        self._waiting = None
        try:
            controller.start(state, tip_ref, trocar)
            first = controller.tick(state, tip_ref, trocar)
            controller.start(state, tip_ref, trocar)
        except MocOptError as error:
            if controller is self._controller:
                raise
            self._name, self._control = self._used
            self.messages.append(f"{error}; {self._name} goes on")
            return
        if self._ticks:
            self._offset = self._sent - first
            controller.set_applied_torque(self._sent)
        self._controller, self._used = controller, asked

    def _fade(self) -> None:
        if self._offset.any():
            self._offset = self._offset * np.exp(-self.period_s / BLEND_S)
            if np.abs(self._offset).max() < 1e-6:
                self._offset = np.zeros(self.robot.n)

    def _note(self, t: float, state: RobotState, tip_ref: Array, trocar: Array, tick_us: float) -> None:
        n = self.robot.n
        tip, wrist, force = self._truth[2 * n :].reshape(3, 3)
        if self._ticks % BOUND_EVERY_TICKS == 0:
            self._bound = self._largest_mu(state.q)
        with self._lock:
            self._history.add(
                t, state.mu, self._bound, float(np.linalg.norm(tip - tip_ref)),
                float(shaft_distance(tip, wrist, trocar)), float(np.linalg.norm(force)),
                self._controller.solve_us, tick_us,
            )  # fmt: skip
        self._show(state, tip_ref, trocar)

    def _largest_mu(self, q: Array) -> float:
        try:
            return self_motion(self.robot, np.clip(q, self.robot.q_min, self.robot.q_max), 0.1).mu_best
        except RobotError:
            return float("nan")  # a singular pose: no single curve leads through it

    def _show(self, state: RobotState, tip_ref: Array, trocar: Array) -> None:
        solution = self._controller.solution
        moment = Moment(
            self._ticks * self.period_s, state.q, state.tip, np.array(tip_ref), np.array(trocar), state.J_tip, state.mu,
            self._used[0], "none" if solution is None else solution.status.label, self._stopped,
        )  # fmt: skip
        with self._lock:
            self._moment = moment

    def _halt(self, reason: str) -> None:
        self._stopped = f"stopped at {self._ticks * self.period_s:.2f} s: {reason}"
        self.messages.append(f"{self._stopped}; change what caused it and reset")
        seen = self._moment
        self._show(self.robot.state(seen.q), seen.tip_ref, seen.trocar)

    def _move_trocar(
        self, offset: Array | None = None, amplitude: float | None = None, period_s: float | None = None
    ) -> None:
        known = self.scenario.trocar.breathing_known
        for trocar in (self._trocar, self._registered):
            trocar.offset = trocar.offset if offset is None else offset
            if trocar is self._trocar or known:
                trocar.amplitude = trocar.amplitude if amplitude is None else amplitude
                trocar.period_s = trocar.period_s if period_s is None else period_s

    def _push(self, force_N: float, seconds: float) -> None:
        direction = self._elbow.direction(self._plant.q)
        self._plant.push(self._elbow_link, force_N * direction)
        self._push_until = self._ticks + max(1, round(seconds / self.period_s))

    def _build(self, control: ControlSettings, name: str) -> Controller:
        settings = self.scenario.solver.settings if name == self.scenario.solver.name else {}
        solver = None if name == DCAC else make_solver(name, self._workshop, **settings)
        return Controller(self.robot, control, solver, self.period_s)

    def _exchange(self, control: ControlSettings, name: str) -> None:
        gently = control.model_copy(update={"ramp_s": max(control.ramp_s, RAMP_S)})
        controller = self._build(gently, name)
        self._control, self._name = control, name

        def exchange() -> None:
            self._waiting = controller, (name, control)

        self._todo.put(exchange)


class _LiveController:
    """A live run as its guarded loop calls it."""

    def __init__(self, run: LiveRun) -> None:
        self._run = run

    @property
    def tip(self) -> Array:
        """Where the last tick saw the tip (3,) [m]."""
        return self._run._state.tip

    @property
    def state(self) -> RobotState:
        """The model's state at the last tick."""
        return self._run._state

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Nothing: the controller starts at its first tick, when it takes over."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """See ``sim.safe.TorqueController``."""
        return self._run._asked(q, v, tip_ref, trocar)

    def set_applied_torque(self, tau: Array) -> None:
        """See ``sim.safe.TorqueController``."""
        self._run._controller.set_applied_torque(tau)
