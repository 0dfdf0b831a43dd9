"""The live page: a loop in step with the clock, and viser to show and command it."""

from __future__ import annotations

import hmac
import io
import secrets
import signal
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from threading import Event, RLock
from time import monotonic
from typing import Any

import numpy as np

from moc_opt import solvers
from moc_opt.arrays import Array
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError
from moc_opt.inputs.names import in_markdown
from moc_opt.live.run import DCAC, QUANTITIES, LiveError, LiveRun, Moment
from moc_opt.report.replay import BASE, arm_parts
from moc_opt.robots.model import link_frames
from moc_opt.scenario import Scenario

HOST, PORT = "127.0.0.1", 8642
FRAME_S, MOST_LAG_S, PIECE_S = 0.08, 0.2, 0.02
COLOURS = {"shell": (211, 216, 221), "tool": (95, 102, 110), "joint": (0, 114, 178)}
TROCAR, PATH = (168, 91, 69), (31, 35, 40)
ELLIPSOID = 1.0 / 6.0  # of its true size
BLUE, ORANGE, GREEN, MUTED = "#0072b2", "#d55e00", "#009e73", "#77787b"
PLOTS: dict[str, list[tuple[str, str, float, str]]] = {
    "µ and the largest on its self-motion curve [m³]": [("mu", "µ", 1.0, BLUE), ("mu_bound", "largest", 1.0, MUTED)],
    "RCM error, tip error in space [mm]": [("rcm_error_m", "RCM", 1e3, BLUE), ("tip_error_m", "tip", 1e3, ORANGE)],
    "force of the trocar [N]": [("force_N", "force", 1.0, BLUE)],
    "whole tick, solver [µs]": [("tick_us", "tick", 1.0, BLUE), ("solve_us", "solver", 1.0, GREEN)],
}
"""Title -> (quantity, name, factor to the unit shown, colour)."""
FIELDS = {
    "regularization": "ρ", "K_X": "K_X [N/m]", "K_N": "K_N [N/m]", "K_N2": "K_N2 [N m s/rad]",
    "D_N2": "D_N2 [N m s/rad]", "k0_per_s": "k0 [1/s]",
}  # fmt: skip
"""Setting of the control law -> its label."""


class LivePage:
    """A run, its clock and its page on loopback, at the port or the next free one; a context manager that ends all.

    Attributes:
        url: the address with the token; without the token nobody is shown or obeyed.

    Raises:
        LiveError: viser is missing, or there is no such port.
        MocOptError: the scenario is not usable.
    """

    def __init__(self, scenario: Scenario, *, port: int = PORT, title: str = "") -> None:
        if not 0 <= port < 65536:
            raise LiveError(f"--port {port}: give 0 to 65535")
        try:
            import viser
        except ImportError as error:
            raise LiveError("the live page needs viser: pip install '.[live]' in the clone") from error
        self.run = LiveRun(scenario)
        self._over, token = Event(), secrets.token_urlsafe(24)
        with redirect_stdout(io.StringIO()):  # its greeting
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
        """Run in step with the clock and keep the page up to date until `stop`.

        A delay that is too long to catch up with is dropped, and shows in the pace.
        """
        run, before, owed, frame, pace = self.run, monotonic(), 0.0, 0.0, 1.0
        while not self._over.wait(PIECE_S):
            now = monotonic()
            passed, before = now - before, now
            if self._panel.paused:
                owed = 0.0
            else:
                kept = min(owed + passed, MOST_LAG_S) - owed
                owed, pace = owed + kept, pace + min(1.0, passed) * (kept / max(passed, 1e-9) - pace)
            ticks = int(owed / run.period_s)
            owed -= ticks * run.period_s
            run.advance(ticks)
            if now >= frame:
                frame = now + FRAME_S
                with self.server.atomic():
                    self._scene.update(run.moment())
                    self._panel.update(run.moment(), pace)

    def stop(self) -> None:
        """Let `wait` come to an end."""
        self._over.set()


def _refuse_without(token: str, server: Any) -> None:
    """Close each WebSocket that does not ask for the token's path, before it is told or obeyed.

    A browser lets any site open a WebSocket to this machine, and a foreign name may be made to point here (DNS
    rebinding): neither knows the token. viser calls this hook before it reads or writes a message.
    """
    sockets = server._websock_server

    @sockets.on_client_connect
    async def check(client: Any) -> None:
        from websockets.exceptions import ConnectionClosed  # it comes with viser, which is an extra

        connection = sockets._live_connections[client.client_id]
        if not hmac.compare_digest(connection.request.path.encode(errors="replace"), f"/{token}".encode()):
            await connection.close(1008, "open the address that was printed; it holds a token")
            with suppress(ConnectionClosed):
                while True:  # what came before it was closed would be obeyed
                    await connection.recv()

    sockets.disconnect_all_clients()  # whoever came before the hook


class Panel:
    """The side panel: hands orders to the run and shows how it goes."""

    def __init__(self, server: Any, run: LiveRun) -> None:
        self._server, self._run, gui = server, run, server.gui
        self._doing = RLock()  # viser calls back from many threads, in any order; setting a value calls back too
        self._status = gui.add_markdown("starting")
        choices = [DCAC, *(name for name, reason in solvers.available().items() if reason is None)]
        self._solver = gui.add_dropdown("Solver", choices, initial_value=run.solver)
        self._solver.on_update(lambda _: self._do(self._choose))
        self._plots = [gui.add_uplot(**_empty(title, lines)) for title, lines in PLOTS.items()]
        with gui.add_folder("Trocar"):
            place = [gui.add_slider(f"{axis} [mm]", min=-40.0, max=40.0, step=1.0, initial_value=0.0) for axis in "xyz"]
            for slider in place:
                slider.on_update(lambda _: self._do(lambda: run.place_trocar(*(1e-3 * s.value for s in place))))
        with gui.add_folder("Weights and gains"):
            self._fields = {
                name: gui.add_text(label, self._written(name), hint=ControlSettings.model_fields[name].description)
                for name, label in FIELDS.items()
            }
            gui.add_button("Apply").on_click(lambda _: self._do(self._apply))
        self._pause = gui.add_checkbox("Pause", initial_value=False)
        gui.add_button("Reset to the start").on_click(lambda _: run.reset())

    @property
    def paused(self) -> bool:
        """Whether the user has stopped the clock."""
        return bool(self._pause.value)

    def _choose(self) -> None:
        if self._solver.value != self._run.solver:  # it may have been set back, not chosen
            self._run.choose(self._solver.value)

    def _written(self, name: str) -> str:
        value = getattr(self._run.gains, name, None)
        numbers = [f"{n:g}" for n in np.atleast_1d(getattr(self._run.control, name) if value is None else value)]
        return numbers[0] if len(set(numbers)) == 1 else " ".join(numbers)

    def _apply(self) -> None:
        values: dict[str, Any] = {}  # all at once: half of a change would be another controller
        for name, field in self._fields.items():
            if field.value.strip() == self._written(name):
                continue  # it keeps the digits that are not shown
            try:
                first, *others = map(float, field.value.replace(",", ".").split())
            except ValueError as error:
                raise LiveError(f"{FIELDS[name]} = {field.value!r}: give a number, or one per joint") from error
            values[name] = (first, *others) if others else first
        if values:
            self._run.tune(**values)

    def _do(self, act: Callable[[], None]) -> None:
        """Do what the user wants, or say what is wrong with it; the run goes on either way."""
        with self._doing:
            try:
                act()
            except MocOptError as error:
                self._tell(str(error))
                for name, field in self._fields.items():
                    field.value = self._written(name)

    def _tell(self, text: str) -> None:
        """Show a message on every open page, and the solver that goes on."""
        for client in self._server.get_clients().values():
            client.add_notification("This cannot be done", text[:600], color="red", auto_close_seconds=12)
        self._solver.value = self._run.solver

    def update(self, moment: Moment, pace: float) -> None:
        """Show the run as it is; `pace` is simulated over real time."""
        while self._run.messages:
            self._tell(self._run.messages.popleft())
        rows = self._run.history(300)
        if len(rows) < 2:
            return
        column = dict(zip(QUANTITIES, rows.T, strict=True))
        for plot, lines in zip(self._plots, PLOTS.values(), strict=True):
            plot.data = (column["t_s"], *(factor * column[name] for name, _, factor, _ in lines))
        self._status.content = in_markdown(moment.stopped) or (
            f"**{moment.solver}** · {moment.status} · {moment.t_s:.1f} s, real time × {pace:.2f}"
            f"{' · paused' if self.paused else ''}  \n"
            f"µ {column['mu'][-1]:.3f} m³ · RCM {1e3 * column['rcm_error_m'][-1]:.2f} mm · "
            f"force {column['force_N'][-1]:.1f} N · tick {column['tick_us'][-1]:.0f} µs"
        )


def _empty(title: str, lines: list[tuple[str, str, float, str]]) -> dict[str, Any]:
    """Return the arguments of a plot without data; times are on a log axis, so that one long tick flattens none."""
    times, quiet = "µs" in title, {"ticks": {"show": False}}
    return {
        "data": (np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in lines)), "title": title, "height": 140,
        "series": (
            {"label": "t [s]"}, *({"label": name, "stroke": color, "width": 1.5} for _, name, _, color in lines)
        ),
        "scales": {"x": {"time": False}, **({"y": {"distr": 3, "log": 10}} if times else {})},
        "axes": (quiet, {**quiet, "grid": {"show": times}, "size": 56}), "legend": {"show": len(lines) > 1},
    }  # fmt: skip


class Scene:
    """The arm in three dimensions: what is drawn once, and what moves."""

    def __init__(self, server: Any, run: LiveRun) -> None:
        from trimesh.creation import revolve  # it comes with viser, which is of the extra `live`

        self._run, scene, start = run, server.scene, run.moment()
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
        self._ellipsoid = scene.add_icosphere(
            "/ellipsoid", radius=1.0, color=COLOURS["joint"], opacity=0.25, subdivisions=4, cast_shadow=False
        )
        path = np.array([run.reference.rows(float(t))[0] for t in np.linspace(0.0, run.reference.one_way_s, 300)])
        pieces = np.stack([path[:-1], path[1:]], axis=1).astype(np.float32)
        scene.add_line_segments("/path", pieces, PATH, thickness=1.5, thickness_units="screen")
        x, y, _ = start.state.tip / max(float(np.linalg.norm(start.state.tip[:2])), 1e-6)
        middle = 0.5 * start.state.tip
        server.initial_camera.position = (middle[0] + 1.15 * y + 0.7 * x, middle[1] - 1.15 * x + 0.7 * y, 0.95)
        server.initial_camera.look_at = (middle[0], middle[1], 0.4)
        self.update(start)

    def update(self, moment: Moment) -> None:
        """Move everything to a moment."""
        state = moment.state
        origins, rotations = link_frames(self._run.robot, state.q[None])
        for frame, origin, rotation in zip(self._links[1:], origins[0], rotations[0], strict=True):
            frame.position, frame.wxyz = origin, _quaternion(rotation)
        self._trocar.position = moment.trocar
        axes, sizes, _ = np.linalg.svd(state.J_tip)  # the ellipsoid of tip velocities
        axes[:, 0] *= np.linalg.det(axes)
        self._ellipsoid.scale = tuple(ELLIPSOID * np.maximum(sizes, 1e-4))
        self._ellipsoid.wxyz, self._ellipsoid.position = _quaternion(axes), state.tip


def _quaternion(rotation: Array) -> Array:
    from viser.transforms import SO3  # of the extra `live`

    return np.asarray(SO3.from_matrix(rotation).wxyz)


def serve(scenario: Scenario, *, port: int = PORT, title: str = "") -> int:
    """Open the page and keep it until Ctrl-C; return the exit code."""
    with LivePage(scenario, port=port, title=title) as page:
        # The first Ctrl-C raises nothing, which might leave a lock of the page's threads behind; a second one does.
        def stop(number: int, frame: object) -> None:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            page.stop()

        signal.signal(signal.SIGINT, stop)
        print(f"live at {page.url} - Ctrl-C ends it", file=sys.stderr, flush=True)
        page.wait()
    print("ended", file=sys.stderr)
    return 0
