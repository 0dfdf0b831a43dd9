"""The arm of a live run in viser's three-dimensional view."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.live.orders import Moment
from moc_opt.live.run import LiveRun
from moc_opt.model.frames import link_frames
from moc_opt.numerics.arrays import Array
from moc_opt.report.replay.arm import BASE, arm_parts
from moc_opt.report.replay.tracks import velocity_ellipsoids

SHELL, TOOL, JOINT, WALL, RIM, PATH = (
    (211, 216, 221),
    (95, 102, 110),
    (0, 114, 178),
    (217, 143, 118),
    (168, 91, 69),
    (31, 35, 40),
)
ROLES = {"shell": SHELL, "tool": TOOL, "joint": JOINT}
ELLIPSOID = 1.0 / 6.0
AROUND, HOLE_M, WALL_M = 40, 0.009, 0.13
TAIL_POINTS = 160


class LiveScene:
    """Objects that are drawn once, and objects that move."""

    def __init__(self, server: Any, run: LiveRun) -> None:
        """Draw everything at the run's present moment; `server` is a viser.ViserServer."""
        self._run, self._scene = run, server.scene
        scene, start = server.scene, run.moment()
        scene.set_up_direction("+z")
        scene.add_grid("/ground", width=2.4, height=2.4, cell_size=0.1, section_size=0.5)
        self._links = [
            scene.add_frame(f"/arm/{name}", show_axes=False) for name in ("base", *run.robot.data.joint_names)
        ]
        names = ("base", *run.robot.data.joint_names)
        for k, part in enumerate(arm_parts(run.robot)):
            vertices, faces = lathe(np.array(part.radii), np.array(part.heights))
            scene.add_mesh_simple(
                f"/arm/{names[part.link - BASE]}/part{k}", vertices, faces, color=ROLES[part.role], side="double",
                wxyz=_quaternion(_frame(np.array(part.axis))), position=np.array(part.origin),
            )  # fmt: skip
        radii = np.linspace(HOLE_M, WALL_M, 12)
        self._wall = scene.add_frame("/wall", show_axes=False)
        patch = lathe(radii, np.sqrt(0.45**2 - radii**2) - 0.45)
        scene.add_mesh_simple("/wall/patch", *patch, color=WALL, opacity=0.45, side="double", cast_shadow=False)
        for name, radius in (("opening", HOLE_M), ("edge", WALL_M)):
            turn = np.linspace(0.0, 2.0 * np.pi, 13)
            drop = float(np.sqrt(0.45**2 - radius**2) - 0.45)
            ring = lathe(radius - 0.002 * np.cos(turn), 0.002 * np.sin(turn) + drop)
            scene.add_mesh_simple(f"/wall/{name}", *ring, color=RIM, side="double")
        self._ellipsoid = scene.add_icosphere(
            "/ellipsoid", radius=1.0, color=JOINT, opacity=0.25, subdivisions=4, cast_shadow=False
        )
        times = np.linspace(0.0, run.one_way_s, 300)
        asked = np.array([run.reference.rows(float(t))[0] for t in times])
        scene.add_line_segments("/asked", _segments(asked), PATH, thickness=1.5, thickness_units="screen")
        self._tail = np.repeat(start.tip[None], TAIL_POINTS, axis=0)
        self._taken = scene.add_line_segments(
            "/taken", _segments(self._tail), JOINT, thickness=3.5, thickness_units="screen"
        )
        middle = np.append(0.5 * start.tip[:2], 0.4)
        out = start.tip[:2] / max(float(np.linalg.norm(start.tip[:2])), 1e-6)
        side = np.array([out[1], -out[0]])
        server.initial_camera.position = np.append(middle[:2] + 1.15 * side + 0.7 * out, 0.95)
        server.initial_camera.look_at = middle
        self.update(start)

    def update(self, moment: Moment) -> None:
        """Move everything to a moment."""
        origins, rotations = link_frames(self._run.robot.chain, moment.q[None])
        for frame, origin, rotation in zip(self._links[1:], origins[0], rotations[0], strict=True):
            frame.position, frame.wxyz = origin, _quaternion(rotation)
        self._wall.position = moment.trocar
        values, vectors = np.linalg.eigh(velocity_ellipsoids(moment.J_tip[None])[0])
        vectors[:, 0] *= np.sign(np.linalg.det(vectors))
        self._ellipsoid.scale = tuple(ELLIPSOID * np.maximum(values, 1e-4))
        self._ellipsoid.wxyz, self._ellipsoid.position = _quaternion(vectors), moment.tip
        if np.linalg.norm(moment.tip - self._tail[-1]) > 5e-4:
            self._tail = np.concatenate([self._tail[1:], moment.tip[None]])
            self._taken.points = _segments(self._tail)


def lathe(radii: Array, heights: Array, around: int = AROUND) -> tuple[Array, NDArray[np.int64]]:
    """Turn a profile about z: vertices (v, 3) and triangles (f, 3)."""
    turn = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rings = np.concatenate(
        [radii[:, None, None] * circle, np.broadcast_to(heights[:, None, None], (len(radii), around, 1))], axis=2
    )
    ring, k = np.meshgrid(np.arange(len(radii) - 1), np.arange(around), indexing="ij")
    a, b = ring * around + k, ring * around + (k + 1) % around
    faces = np.concatenate([np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)])
    return rings.reshape(-1, 3), faces.reshape(-1, 3)


def _segments(points: Array) -> NDArray[np.float32]:
    """Return (k - 1, 2, 3) pieces of a line through (k, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def _frame(axis: Array) -> Array:
    """Return (3, 3) a rotation whose z axis is `axis`."""
    beside = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    across = np.cross(beside, axis)
    x = across / np.linalg.norm(across)
    return np.asarray(np.stack([x, np.cross(axis, x), axis], axis=1), dtype=np.float64)


def _quaternion(rotation: Array) -> Array:
    """Return (4,) w, x, y, z."""
    from viser.transforms import SO3

    return np.asarray(SO3.from_matrix(rotation).wxyz, dtype=np.float64)
