"""The surgeon's view: task, tip and trocar drawn into the camera's picture, saved as pictures or a film."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path as File

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array
from moc_opt.vision.camera import Camera, Picture

Colour = tuple[int, int, int]

TASK, DONE, TIP, TROCAR, TEXT = (80, 220, 60), (200, 140, 20), (0, 215, 255), (255, 120, 240), (255, 255, 255)

# What OpenCV's wheel writes without any library of the system; a browser plays webm, not mp4v.
_CODECS = {".webm": "VP80", ".mp4": "mp4v", ".avi": "MJPG"}
_NEAR_M = 0.01


class Overlay:
    """Draw into pictures with the camera's pose as the robot has it, so that the drawing shows the robot's plan."""

    def __init__(self, camera: Camera) -> None:
        """Use this camera's intrinsics and its place in the base frame."""
        self._camera = camera

    def draw(
        self, picture: Picture, *, task: ArrayLike | None = None, progress: float = 0.0, tip: ArrayLike | None = None,
        trocar: ArrayLike | None = None, text: str = "",
    ) -> Picture:  # fmt: skip
        """Draw the overlay into a copy of the picture.

        Args:
            picture: (H, W, 3).
            task: (k, 3) points along the path, base frame [m].
            progress: share of the path that is done, 0 to 1: drawn in another colour.
            tip: (3,) base frame [m].
            trocar: (3,) base frame [m]; mostly outside the picture, so a line is drawn towards it from the tip.
            text: a line at the bottom.
        """
        page = picture.copy()
        if task is not None:
            points = np.atleast_2d(np.asarray(task, dtype=np.float64))
            done = round(min(max(progress, 0.0), 1.0) * (len(points) - 1))
            self._polyline(page, points[done:], TASK)
            self._polyline(page, points[: done + 1], DONE)
        if tip is not None and trocar is not None:
            self._towards(page, np.asarray(tip, dtype=np.float64), np.asarray(trocar, dtype=np.float64))
        if tip is not None:
            self._cross(page, np.asarray(tip, dtype=np.float64))
        if text:
            _write(page, text, (6, page.shape[0] - 8))
        return page

    def _polyline(self, page: Picture, points: Array, colour: Colour) -> None:
        pixels = self._camera.project(points)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if len(pixels) > 1:
            cv2.polylines(page, [_fixed(pixels)], False, colour, 2, cv2.LINE_AA, 4)

    def _cross(self, page: Picture, point: Array) -> None:
        pixel = self._camera.project(point)[0]
        if np.isfinite(pixel).all() and np.abs(pixel).max() < 1e4:
            place = (round(float(pixel[0])), round(float(pixel[1])))
            cv2.drawMarker(page, place, TIP, cv2.MARKER_CROSS, 16, 2, cv2.LINE_AA)

    def _towards(self, page: Picture, tip: Array, trocar: Array) -> None:
        """Draw a line from the tip to the trocar, as far as it is before the camera, with its name where it ends."""
        to_camera = self._camera.camera_in_base.inverse()
        near, far = float(to_camera.apply(tip)[2]), float(to_camera.apply(trocar)[2])
        if near <= _NEAR_M:
            return
        end = trocar if far >= _NEAR_M else tip + (near - _NEAR_M) / (near - far) * (trocar - tip)
        start, stop = self._camera.project(np.array([tip, end]))
        width, height = self._camera.size_px
        ends = [tuple(int(part) for part in np.rint(np.clip(pixel, -1e6, 1e6))) for pixel in (start, stop)]
        inside, first, last = cv2.clipLine((0, 0, width, height), ends[0], ends[1])
        if not inside:
            return
        cv2.line(page, first, last, TROCAR, 1, cv2.LINE_AA)
        label = (min(max(last[0] + 6, 0), width - 60), min(max(last[1], 16), height - 8))
        cv2.putText(page, "trocar", label, cv2.FONT_HERSHEY_SIMPLEX, 0.45, TROCAR, 1, cv2.LINE_AA)


def save_picture(path: str | os.PathLike[str], picture: Picture) -> None:
    """Write one picture; the kind of file is in its name (.png, .jpg).

    Raises:
        PlantError: it cannot be written.
    """
    _checked(File(path))
    try:
        written = cv2.imwrite(str(path), picture)
    except cv2.error as error:
        raise PlantError(f"picture {str(path)!r} cannot be written ({error}): give a name in .png") from error
    if not written:
        raise PlantError(f"picture {str(path)!r} cannot be written: check the folder's rights and space")


def save_video(path: str | os.PathLike[str], pictures: Iterable[Picture], rate_Hz: float) -> int:
    """Write a film: .webm, .mp4 or .avi; a name without a suffix is a folder of numbered PNG pictures.

    Args:
        path: the film or folder.
        pictures: (H, W, 3) each, all of one size; they are written as they come.
        rate_Hz: pictures in a second.

    Returns:
        The number of pictures.

    Raises:
        PlantError: unknown suffix, no pictures, sizes differ, or it cannot be written.
    """
    file = File(path)
    if not (math.isfinite(rate_Hz) and rate_Hz > 0.0):
        raise PlantError(f"rate_Hz = {rate_Hz!r}: give pictures in a second, above zero")
    if file.suffix and file.suffix.lower() not in _CODECS:
        raise PlantError(f"film {str(path)!r}: give a name in {', '.join(_CODECS)}, or a folder without a suffix")
    _checked(file)
    count = _numbered(file, pictures) if not file.suffix else _film(file, pictures, rate_Hz)
    if count == 0:
        raise PlantError(f"film {str(path)!r} has no pictures: give one or more")
    return count


def _numbered(folder: File, pictures: Iterable[Picture]) -> int:
    count = 0
    for count, picture in enumerate(pictures, start=1):
        folder.mkdir(parents=True, exist_ok=True)
        save_picture(folder / f"{count:06d}.png", picture)
    return count


def _film(file: File, pictures: Iterable[Picture], rate_Hz: float) -> int:
    writer, shape, count = None, None, 0
    try:
        for picture in pictures:
            if writer is None:
                shape = picture.shape
                code = cv2.VideoWriter.fourcc(*_CODECS[file.suffix.lower()])
                writer = cv2.VideoWriter(str(file), code, rate_Hz, (shape[1], shape[0]))
                if not writer.isOpened():
                    raise PlantError(
                        f"film {str(file)!r}: this OpenCV cannot write it; give a folder without a suffix, for PNG"
                    )
            elif picture.shape != shape:
                raise PlantError(f"film {str(file)!r}: picture {count} is {picture.shape}, the first was {shape}")
            writer.write(picture)
            count += 1
    finally:
        if writer is not None:
            writer.release()
    return count


def _checked(file: File) -> None:
    if not file.parent.is_dir():
        raise PlantError(f"{str(file)!r}: its folder does not exist; make it first")


def _write(page: Picture, text: str, corner: tuple[int, int]) -> None:
    """Write white on a dark ground, its lower left corner given [px]."""
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    x, y = corner
    cv2.rectangle(page, (x - 4, y - height - 4), (x + width + 4, y + below + 2), (40, 40, 40), cv2.FILLED)
    cv2.putText(page, text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, TEXT, 1, cv2.LINE_AA)


def _fixed(pixels: Array) -> NDArray[np.int32]:
    """Return the pixels in sixteenths, as OpenCV's drawing functions take them."""
    return np.rint(16.0 * np.clip(pixels, -1e5, 1e5)).astype(np.int32)
