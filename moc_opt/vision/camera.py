"""The endoscope's camera: a pinhole with its place in the robot's base frame, and its blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array
from moc_opt.vision.pose import Pose, looking_at, rotation_from
from moc_opt.vision.settings import CameraSettings

Picture = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics and extrinsics; the camera's frame has x right, y down, z along the view (OpenCV's)."""

    settings: CameraSettings
    camera_in_base: Pose

    @property
    def focal_px(self) -> float:
        """Focal length [px], the same both ways."""
        return 0.5 * self.settings.height_px / math.tan(0.5 * math.radians(self.settings.fov_deg))

    @property
    def matrix(self) -> Array:
        """K (3, 3). A pixel's number is its middle, so the view's axis is at (W - 1)/2, (H - 1)/2, not W/2, H/2."""
        f = self.focal_px
        return np.array(
            [
                [f, 0.0, 0.5 * self.settings.width_px - 0.5],
                [0.0, f, 0.5 * self.settings.height_px - 0.5],
                [0.0, 0.0, 1.0],
            ]
        )

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.settings.width_px, self.settings.height_px

    def project(self, points_in_base: ArrayLike) -> Array:
        """Project points to pixels (k, 2) of points (k, 3) [m] of the base frame; NaN for points behind the camera."""
        points = self.camera_in_base.inverse().apply(np.atleast_2d(np.asarray(points_in_base, dtype=np.float64)))
        depth = np.where(points[:, 2] > 1e-6, points[:, 2], np.nan)
        pixels = points @ self.matrix.T
        return np.asarray(pixels[:, :2] / depth[:, None])

    @classmethod
    def above(cls, settings: CameraSettings, phantom_in_base: Pose) -> Camera:
        """Place the camera of the settings: it looks at the phantom's middle, its top towards the board's y."""
        tilt, azimuth = math.radians(settings.tilt_deg), math.radians(settings.azimuth_deg)
        away = [math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]
        eye = settings.distance_m * np.array(away)
        # Seen from along the board's y, its y is still the upper side while the tilt is below a right angle.
        return cls(settings, phantom_in_base @ looking_at(eye, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))

    def miscalibrated(self, seed: int) -> Camera:
        """Return the same camera where the robot's calibration takes it to be: off by the settings' errors, seeded."""
        away, axis = np.random.default_rng(seed).standard_normal((2, 3))
        turn = math.radians(self.settings.calibration_error_deg) * axis / np.linalg.norm(axis)
        error = Pose(rotation_from(turn), self.settings.calibration_error_m * away / np.linalg.norm(away))
        return Camera(self.settings, self.camera_in_base @ error)


@dataclass(frozen=True, eq=False)
class Scene:
    """What the camera looks at.

    Args:
        board_in_base: where the board truly is.
        hidden: numbers of the markers that are covered by something.
        dark: nothing can be seen of the board (smoke, blood on the lens, the camera turned away).
        q: (n,) pose of the arm [rad], whose tool can be in the way; None: no arm.
    """

    board_in_base: Pose
    hidden: frozenset[int] = frozenset()
    dark: bool = False
    q: Array | None = None


class View(Protocol):
    """A source of pictures."""

    @property
    def camera(self) -> Camera:
        """The true camera."""

    def picture(self, scene: Scene) -> Picture:
        """Take the camera's picture (H, W, 3), blue green red, blurred and noisy."""


class Sensor:
    """Blur of the lens, then noise of the sensor; the same for every source of pictures."""

    def __init__(self, settings: CameraSettings, seed: int) -> None:
        """Begin the noise."""
        self._settings, self._rng = settings, np.random.default_rng(seed)

    def expose(self, picture: Picture) -> Picture:
        """Return a blurred and noisy copy (H, W, 3)."""
        blur, noise = self._settings.blur_px, self._settings.noise
        if blur > 0.0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur), dtype=np.uint8)
        if noise > 0.0:
            # One grain for all three colours: it is the grey levels that are looked at.
            grain = np.rint(noise * self._rng.standard_normal(picture.shape[:2], dtype=np.float32))
            bright = picture.astype(np.int16) + grain.astype(np.int16)[:, :, None]
            picture = np.clip(bright, 0, 255).astype(np.uint8)
        return picture


def hide(ids: range, fraction: float, seed: int) -> frozenset[int]:
    """Draw which markers are covered: the whole number nearest to `fraction` of them.

    A larger fraction of the same seed covers the same ones and more.

    Raises:
        PlantError: the fraction is outside [0, 1].
    """
    if not 0.0 <= fraction <= 1.0:
        raise PlantError(f"hidden_fraction = {fraction!r}: give a fraction from 0 to 1")
    order = np.random.default_rng(seed).permutation(np.array(ids))
    return frozenset(order[: round(fraction * len(ids))].tolist())
