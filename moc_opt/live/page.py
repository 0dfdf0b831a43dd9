"""The live page of a `LiveRun`."""

from __future__ import annotations

import hmac
import io
import secrets
import signal
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from queue import SimpleQueue
from threading import Event
from time import monotonic
from typing import Any

import numpy as np

from moc_opt import solvers
from moc_opt.arrays import Array
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError
from moc_opt.inputs.names import in_markdown
from moc_opt.live.run import DCAC, QUANTITIES, LiveError, LiveRun, solver_of
from moc_opt.report.replay import BASE, arm_parts
from moc_opt.robots.model import link_frames
from moc_opt.scenario import Scenario

HOST, PORT = "127.0.0.1", 8642
FRAME_S, MOST_LAG_S, PIECE_S = 0.08, 0.2, 0.02  # time between frames, tolerated lag, time between groups of ticks [s]
COLOURS = {"shell": (211, 216, 221), "tool": (95, 102, 110), "joint": (0, 114, 178)}
TROCAR, PATH = (168, 91, 69), (31, 35, 40)
BLUE, ORANGE, GREEN = "#0072b2", "#d55e00", "#009e73"
PLOTS: dict[str, list[tuple[str, str, float, str]]] = {
    "µ [m³]": [("mu", "µ", 1.0, BLUE)],
    "RCM error, tip error (base frame) [mm]": [("rcm_error_m", "RCM", 1e3, BLUE), ("tip_error_m", "tip", 1e3, ORANGE)],
    "force of the trocar [N]": [("force_N", "force", 1.0, BLUE)],
    "time of a tick and of its solver [µs]": [("tick_us", "tick", 1.0, BLUE), ("solve_us", "solver", 1.0, GREEN)],
}
"""Curves of each plot: quantity, name, factor to the unit shown, colour."""
FIELDS = ("regularization", "K_X", "K_N", "K_N2", "D_N2", "k0_per_s")  # settings on the page


class LivePage:
    """A run and its page on loopback, at ``port`` or the next free port, for clients with the token in ``url``.

    Leaving the context stops both. Raises a LiveError if viser is missing or the port is invalid.
    """

    def __init__(self, scenario: Scenario, *, port: int = PORT, title: str = "") -> None:
        if not 0 <= port < 65536:
            raise LiveError(f"--port {port}: give 0 to 65535")
        try:
            import viser
        except ImportError as error:
            raise LiveError("the live page needs viser: pip install '.[live]' in the clone") from error
        self.run, self._over, token = LiveRun(scenario), Event(), secrets.token_urlsafe(24)
        with redirect_stdout(io.StringIO()):  # suppresses viser's greeting
            self.server = viser.ViserServer(HOST, port, f"moc_opt: {title or scenario.name}", verbose=False)
        _refuse_without(token, self.server)
        address = f"{HOST}:{self.server.get_port()}"
        self.url = f"http://{address}/?websocket=ws://{address}/{token}"
        self.server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._scene, self._panel = Scene(self.server, self.run), Panel(self.server, self.run)

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def wait(self) -> None:
        """Run in real time until `stop` is called. The part of a lag above `MOST_LAG_S` is skipped."""
        run, reached, pace, done = self.run, monotonic(), 1.0, 0
        frame = reached
        while not self._over.wait(PIECE_S):
            self._panel.obey()
            now = monotonic()
            reached = max(reached, now - MOST_LAG_S)
            ticks = int((now - reached) / run.period_s)
            run.advance(ticks)
            reached, done = reached + ticks * run.period_s, done + ticks
            if now >= frame + FRAME_S:
                pace += 0.1 * (done * run.period_s / (now - frame) - pace)
                frame, done = now, 0
                with self.server.atomic():
                    self._scene.update()
                    self._panel.update(pace)

    def stop(self) -> None:
        """Make `wait` return."""
        self._over.set()


def _refuse_without(token: str, server: Any) -> None:
    """Close WebSockets without the token, because any web site can open one to this machine."""
    sockets = server._websock_server

    @sockets.on_client_connect
    async def check(client: Any) -> None:
        from websockets.exceptions import ConnectionClosed  # in the extra `live`

        connection = sockets._live_connections[client.client_id]
        if not hmac.compare_digest(connection.request.path.encode(errors="replace"), f"/{token}".encode()):
            await connection.close(1008, "open the address that was printed; it holds a token")
            with suppress(ConnectionClosed):
                while True:  # discard messages that viser would obey
                    await connection.recv()

    sockets.disconnect_all_clients()  # clients may have connected before the hook was set


class Panel:
    """The side panel. Its orders are queued for the loop's thread, because viser calls back from many threads."""

    def __init__(self, server: Any, run: LiveRun) -> None:
        self._server, self._run, gui = server, run, server.gui
        self.orders: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._status = gui.add_markdown("starting")
        choices = [DCAC, *(name for name, reason in solvers.available().items() if reason is None)]
        self._solver = gui.add_dropdown("Solver", choices, initial_value=run.solver)
        self._solver.on_update(lambda _: self.orders.put(self._choose))
        self._plots = [_plot(gui, title, lines) for title, lines in PLOTS.items()]
        with gui.add_folder("Trocar"):
            self._place = [
                gui.add_slider(f"{axis} [mm]", min=-40.0, max=40.0, step=1.0, initial_value=0.0) for axis in "xyz"
            ]
            for slider in self._place:
                slider.on_update(lambda _: self.orders.put(self._move_trocar))
        with gui.add_folder("Weights and gains"):
            self._fields = {
                name: gui.add_text(name, self._written(name), hint=ControlSettings.meaning(name))
                for name in FIELDS
            }
            gui.add_button("Apply").on_click(lambda _: self.orders.put(self._apply))
        gui.add_button("Reset to the start").on_click(lambda _: self.orders.put(run.reset))

    def obey(self) -> None:
        """Carry out the queued orders, and show their errors."""
        while not self.orders.empty():
            try:
                self.orders.get()()
            except MocOptError as error:
                self._tell(str(error))
                for name, field in self._fields.items():
                    field.value = self._written(name)

    def _choose(self) -> None:
        if self._solver.value != self._run.solver:
            self._run.choose(self._solver.value)

    def _move_trocar(self) -> None:
        self._run.place_trocar(*(1e-3 * slider.value for slider in self._place))

    def _written(self, name: str) -> str:
        control, robot = self._run.control, self._run.robot
        gains = control.resolve_gains(robot.data.gains, robot.n)
        numbers = [f"{n:g}" for n in np.atleast_1d(getattr(gains, name, getattr(control, name)))]
        return numbers[0] if len(set(numbers)) == 1 else " ".join(numbers)

    def _apply(self) -> None:
        values: dict[str, Any] = {}  # all changes are applied, or none
        for name, field in self._fields.items():
            if field.value.strip() != self._written(name):  # an unchanged setting keeps all its digits
                try:
                    first, *others = map(float, field.value.replace(",", ".").split())
                except ValueError as error:
                    raise LiveError(f"{name} = {field.value!r}: give a number, or one per joint") from error
                values[name] = (first, *others) if others else first
        if values:
            self._run.tune(**values)

    def _tell(self, text: str) -> None:
        for client in self._server.get_clients().values():
            client.add_notification("This cannot be done", text[:600], color="red", auto_close_seconds=12)
        self._solver.value = self._run.solver

    def update(self, pace: float) -> None:
        """Show the state of the run; `pace` is simulated time / real time."""
        run = self._run
        while run.messages:
            self._tell(run.messages.popleft())
        rows = run.history(300)
        if len(rows) < 2:
            return
        column = dict(zip(QUANTITIES, rows.T, strict=True))
        for plot, lines in zip(self._plots, PLOTS.values(), strict=True):
            plot.data = (column["t_s"], *(factor * column[name] for name, _, factor, _ in lines))
        claim = "none" if run.used.solution is None else run.used.solution.status.label
        self._status.content = in_markdown(run.stopped) or (
            f"**{solver_of(run.used)}** · {claim} · {run.t_s:.1f} s, real time × {pace:.2f}  \n"
            f"µ {column['mu'][-1]:.3f} m³ · RCM {1e3 * column['rcm_error_m'][-1]:.2f} mm · "
            f"force {column['force_N'][-1]:.1f} N · tick {column['tick_us'][-1]:.0f} µs"
        )


def _plot(gui: Any, title: str, lines: list[tuple[str, str, float, str]]) -> Any:
    times, quiet = "µs" in title, {"ticks": {"show": False}}
    named = [{"label": name, "stroke": color, "width": 1.5} for _, name, _, color in lines]
    return gui.add_uplot(
        (np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in lines)), ({"label": "t [s]"}, *named), title=title,
        scales={"x": {"time": False}, **({"y": {"distr": 3, "log": 10}} if times else {})}, height=140,
        axes=(quiet, {**quiet, "grid": {"show": times}, "size": 56}), legend={"show": len(lines) > 1},
    )  # fmt: skip


class Scene:
    """Arm, trocar and path in three dimensions."""

    def __init__(self, server: Any, run: LiveRun) -> None:
        from trimesh.creation import revolve  # in the extra `live`

        self._run, scene, tip = run, server.scene, run.state.tip
        scene.set_up_direction("+z")
        scene.add_grid("/ground", width=2.4, height=2.4, cell_size=0.1, section_size=0.5)
        names = ("base", *run.robot.data.joint_names)
        self._links = [scene.add_frame(f"/arm/{name}", show_axes=False) for name in names]
        for k, part in enumerate(arm_parts(run.robot)):
            turned = revolve(np.stack([part.radii, part.heights], axis=1), sections=40)
            side = np.linalg.svd(part.axis[None])[2][1]
            upright = np.stack([side, np.cross(part.axis, side), part.axis], axis=1)
            scene.add_mesh_simple(
                f"/arm/{names[part.link - BASE]}/part{k}", turned.vertices, turned.faces, color=COLOURS[part.role],
                side="double", position=part.origin, wxyz=_quaternion(upright),
            )  # fmt: skip
        self._trocar = scene.add_icosphere("/trocar", radius=0.006, color=TROCAR)
        pieces = np.stack([run.path[:-1], run.path[1:]], axis=1).astype(np.float32)
        scene.add_line_segments("/path", pieces, PATH, thickness=1.5, thickness_units="screen")
        x, y, _ = tip / max(float(np.linalg.norm(tip[:2])), 1e-6)
        server.initial_camera.position = (0.5 * tip[0] + 1.15 * y + 0.7 * x, 0.5 * tip[1] - 1.15 * x + 0.7 * y, 0.95)
        server.initial_camera.look_at = (0.5 * tip[0], 0.5 * tip[1], 0.4)
        self.update()

    def update(self) -> None:
        """Move links and trocar."""
        origins, rotations = link_frames(self._run.robot, self._run.state.q[None])
        for frame, origin, rotation in zip(self._links[1:], origins[0], rotations[0], strict=True):
            frame.position, frame.wxyz = origin, _quaternion(rotation)
        self._trocar.position = self._run.trocar


def _quaternion(rotation: Array) -> Array:
    from viser.transforms import SO3  # in the extra `live`

    return np.asarray(SO3.from_matrix(rotation).wxyz)


def serve(scenario: Scenario, *, port: int = PORT, title: str = "") -> int:
    """Serve the page until Ctrl-C; return the exit code."""
    with LivePage(scenario, port=port, title=title) as page:
        # A KeyboardInterrupt could leave a lock of the page's threads locked.
        signal.signal(signal.SIGINT, lambda number, frame: page.stop())
        print(f"live at {page.url} - Ctrl-C ends it", file=sys.stderr, flush=True)
        page.wait()
    print("ended", file=sys.stderr)
    return 0
