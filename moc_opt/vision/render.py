"""The camera's picture rendered by MuJoCo, off screen: the arm, the board with its print, and covers on it."""

from __future__ import annotations

import atexit
import ctypes.util
import importlib
import os
import weakref
from typing import Any

import mujoco
import numpy as np

from moc_opt.errors import PlantError
from moc_opt.robots import RobotData
from moc_opt.sim.mjcf import TOOL_BODY, build_spec, compile_model
from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Picture, Scene, Sensor
from moc_opt.vision.markers import board_picture
from moc_opt.vision.pinhole import COVER, SHAFT_RADIUS_M, STEEL, TISSUE, cover_radius

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_THIN = 1e-4  # half the thickness of the board and of the covers [m]


def gl_platform() -> str:
    """Return the off-screen platform of this machine: MUJOCO_GL if it names one, else the first whose library is there.

    Raises:
        PlantError: there is none; the message says what to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    if wanted in _LIBRARIES:
        return wanted
    if wanted in ("disable", "disabled", "off", "false", "0"):
        raise PlantError(f"MUJOCO_GL = {wanted!r}: rendering is switched off; set it to egl or osmesa")
    for platform, library in _LIBRARIES.items():
        if ctypes.util.find_library(library):
            return platform
    raise PlantError(
        "no GL library for off-screen rendering: install libegl1 and libgl1, or libosmesa6, "
        "or set the camera's source to 'drawn'"
    )


class RenderedView:
    """MuJoCo's renderer behind the same face as `DrawnView`.

    The model is the arm's, with a board on a body of its own, one cover for each marker, and the tool's shaft; it
    is drawn at a given pose and never stepped. GL contexts belong to the thread that made them.
    """

    def __init__(self, data: RobotData, camera: Camera, board: Board, *, seed: int = 0) -> None:
        """Build the scene and its GL context.

        Args:
            camera: the true camera.

        Raises:
            PlantError: no GL library is there or it cannot be used, or MuJoCo refuses the model.
        """
        self._camera, self._board = camera, board
        self._sensor = Sensor(camera.settings, seed)
        width, height = camera.size_px
        self._frame = np.empty((height, width, 3), dtype=np.uint8)
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._model = compile_model(data.name, _spec(data, camera, board))
        self._data = mujoco.MjData(self._model)
        self._covers = {marker: self._model.geom(_cover_name(marker)).id for marker in board.ids}
        self._shaft = self._model.geom("shaft").id
        self._board_body = int(self._model.body("board").mocapid[0])
        self._print = self._model.geom("board").id
        self._eye = mujoco.MjvCamera()
        self._eye.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._eye.fixedcamid = self._model.camera("endoscope").id
        self._context = _current_context(width, height)
        self._scene = mujoco.MjvScene(self._model, maxgeom=len(self._covers) + 64)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._drawing = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._option = mujoco.MjvOption()
        self._closer = weakref.finalize(self, _free, self._context, self._drawing)
        # At the interpreter's end this must come before GL's own end, which was registered earlier.
        self._closer.atexit = False
        atexit.register(self._closer)

    @property
    def camera(self) -> Camera:
        """The true camera."""
        return self._camera

    def close(self) -> None:
        """Give GL's memory back; the view cannot be used afterwards."""
        self._closer()

    def picture(self, scene: Scene) -> Picture:
        """Take the camera's picture (H, W, 3), blue green red.

        Raises:
            PlantError: the view was closed, or the scene's pose is not this arm's.
        """
        if not self._closer.alive:
            raise PlantError("this view was closed: make a new one")
        model, state = self._model, self._data
        if scene.q is not None:
            if np.shape(scene.q) != (model.nq,):
                raise PlantError(f"scene q has shape {np.shape(scene.q)}: the arm has {model.nq} joints")
            state.qpos[:] = scene.q
        state.mocap_pos[self._board_body] = scene.board_in_base.t
        mujoco.mju_mat2Quat(state.mocap_quat[self._board_body], scene.board_in_base.R.ravel())
        model.geom_rgba[self._shaft, 3] = 0.0 if scene.q is None else 1.0
        model.geom_rgba[self._print, 3] = 0.0 if scene.dark else 1.0
        for marker, geom in self._covers.items():
            model.geom_rgba[geom, 3] = 1.0 if marker in scene.hidden and not scene.dark else 0.0
        mujoco.mj_kinematics(model, state)
        mujoco.mj_camlight(model, state)
        self._context.make_current()
        mujoco.mjv_updateScene(model, state, self._option, None, self._eye, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        mujoco.mjr_render(self._rectangle, self._scene, self._drawing)
        mujoco.mjr_readPixels(self._frame, None, self._rectangle, self._drawing)
        # MuJoCo's rows go upwards, and its colours are red green blue.
        return self._sensor.expose(np.ascontiguousarray(self._frame[::-1, :, ::-1]))


def _spec(data: RobotData, camera: Camera, board: Board) -> mujoco.MjSpec:
    """Return the arm's model with camera, light, board, covers and shaft."""
    spec = build_spec(data, substep_s=1e-3)
    spec.compiler.discardvisual = False  # a model that comes from a URDF drops every shape that cannot collide
    spec.visual.global_.offwidth, spec.visual.global_.offheight = camera.size_px
    spec.visual.quality.offsamples = 0
    # Everything is lit alike, so that the print keeps its black and white.
    spec.visual.headlight.ambient = (1.0, 1.0, 1.0)
    spec.visual.headlight.diffuse = spec.visual.headlight.specular = (0.0, 0.0, 0.0)
    extent = spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = 0.002 / extent, 5.0 / extent
    _add_background(spec)
    # MuJoCo's cameras look along -z with y up; ours along z with y down.
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, (camera.camera_in_base.R @ np.diag([1.0, -1.0, -1.0])).ravel())
    spec.worldbody.add_camera(name="endoscope", pos=camera.camera_in_base.t, quat=turned, fovy=camera.settings.fov_deg)
    _add_board(spec, board)
    tool = spec.body(TOOL_BODY)
    tool.add_geom(
        name="shaft", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, 0.0, 0.0, data.tool_length],
        size=[SHAFT_RADIUS_M, 0.0, 0.0], rgba=[*_rgb(STEEL), 1.0], **_WEIGHTLESS,
    )  # fmt: skip
    return spec


_WEIGHTLESS: dict[str, Any] = {"contype": 0, "conaffinity": 0, "mass": 0.0}


def _add_background(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="tissue", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=_rgb(TISSUE), rgb2=_rgb(TISSUE), width=64, height=64,
    )  # fmt: skip


def _add_board(spec: mujoco.MjSpec, board: Board) -> None:
    """Add the printed board on a body that can be put anywhere, and a patch over each marker."""
    page = board_picture(board)
    page = np.repeat(page[:, :, None], 3, axis=2)
    texture = spec.add_texture(
        name="print", type=mujoco.mjtTexture.mjTEXTURE_2D, width=page.shape[1], height=page.shape[0], nchannel=3
    )
    texture.data = page.tobytes()
    material = spec.add_material(name="print", texuniform=False)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "print"
    width, height = board.size_m
    body = spec.worldbody.add_body(name="board", mocap=True)
    body.add_geom(
        name="board", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.5 * width, 0.5 * height, 0.1], material="print",
        **_WEIGHTLESS,
    )  # fmt: skip
    for marker in board.ids:
        body.add_geom(
            name=_cover_name(marker),
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=board.corners(marker).mean(axis=0) + np.array([0.0, 0.0, 2.0 * _THIN]),
            size=[cover_radius(board), _THIN, 0.0],
            rgba=[*_rgb(COVER), 0.0],
            **_WEIGHTLESS,
        )


def _cover_name(marker: int) -> str:
    return f"cover_{marker}"


def _rgb(colour: tuple[int, int, int]) -> list[float]:
    """Return red, green, blue from 0 to 1, of blue, green, red to 255."""
    return [part / 255.0 for part in colour[::-1]]


def _current_context(width: int, height: int) -> Any:
    """Return an off-screen GL context, made current; MuJoCo's own chooser needs MUJOCO_GL before the first import."""
    platform = gl_platform()
    try:
        context = importlib.import_module(f"mujoco.{platform}").GLContext(width, height)
        context.make_current()
    # For a missing or unfit library PyOpenGL raises exceptions of many kinds.
    except (ImportError, AttributeError, OSError, RuntimeError, TypeError) as error:
        raise PlantError(
            f"GL platform {platform!r} does not work here ({error}): install libegl1 and libgl1, or libosmesa6 and "
            "set MUJOCO_GL=osmesa, or set the camera's source to 'drawn'"
        ) from error
    return context


def _free(context: Any, drawing: mujoco.MjrContext) -> None:
    context.make_current()
    drawing.free()
    context.free()
