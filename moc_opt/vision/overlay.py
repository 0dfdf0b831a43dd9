"""The surgeon's view: task, tip and trocar drawn into the camera's picture, saved as a film."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path as File

import cv2
import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import PlantError
from moc_opt.vision.camera import Camera, Picture

TASK, DONE, TIP, TROCAR, TEXT = (80, 220, 60), (200, 140, 20), (0, 215, 255), (255, 120, 240), (255, 255, 255)

# What OpenCV's wheel writes without any library of the system; a browser plays webm, not mp4v.
_CODECS = {".webm": "VP80", ".mp4": "mp4v", ".avi": "MJPG"}
_NEAR_M = 0.01


def draw(
    picture: Picture, camera: Camera, *, task: ArrayLike, progress: float, tip: ArrayLike, trocar: ArrayLike, text: str
) -> Picture:
    """Draw the overlay into a copy of the picture.

    Args:
        picture: (H, W, 3).
        camera: where the robot takes it to be, so that the drawing shows the robot's plan.
        task: (k, 3) points along the path, base frame [m].
        progress: share of the path that is done, 0 to 1, drawn in another colour.
        tip: (3,) base frame [m].
        trocar: (3,) base frame [m]; mostly outside the picture, so a line is drawn towards it from the tip.
        text: a line at the bottom.
    """
    page = picture.copy()
    points, end, far = (np.asarray(part, dtype=np.float64) for part in (task, tip, trocar))
    done = round(min(max(progress, 0.0), 1.0) * (len(points) - 1))
    for part, colour in ((points[done:], TASK), (points[: done + 1], DONE)):
        pixels = camera.project(part)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if len(pixels) > 1:
            sixteenths = np.rint(16.0 * np.clip(pixels, -1e5, 1e5)).astype(np.int32)
            cv2.polylines(page, [sixteenths], False, colour, 2, cv2.LINE_AA, 4)
    near, away = camera.camera_in_base.inverse().apply(np.array([end, far]))[:, 2]
    if near > _NEAR_M:
        if away < _NEAR_M:  # behind the camera: the line ends before it
            far = end + (near - _NEAR_M) / (near - away) * (far - end)
        _line_to_trocar(page, *np.clip(camera.project(np.array([end, far])), -1e6, 1e6))
    pixel = camera.project(end)[0]
    if np.isfinite(pixel).all() and np.abs(pixel).max() < 1e4:
        cv2.drawMarker(page, _whole(pixel), TIP, cv2.MARKER_CROSS, 16, 2, cv2.LINE_AA)
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    x, y = 6, page.shape[0] - 8
    cv2.rectangle(page, (x - 4, y - height - 4), (x + width + 4, y + below + 2), (40, 40, 40), cv2.FILLED)
    cv2.putText(page, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, TEXT, 1, cv2.LINE_AA)
    return page


def save_film(path: str | os.PathLike[str], pictures: Iterable[Picture], rate_Hz: float) -> int:
    """Write pictures (H, W, 3) of one size as they come, and return their number.

    Args:
        path: the film (.webm, .mp4 or .avi), in a folder that exists.
        rate_Hz: pictures in a second.

    Raises:
        PlantError: unknown suffix, no pictures, or it cannot be written.
    """
    file = File(path)
    codec = _CODECS.get(file.suffix.lower())
    if codec is None:
        raise PlantError(f"film {str(path)!r}: give a name in {', '.join(_CODECS)}")
    writer, count = cv2.VideoWriter(), 0
    try:
        for picture in pictures:
            if not count:
                writer.open(str(file), cv2.VideoWriter.fourcc(*codec), rate_Hz, picture.shape[1::-1])
            if not writer.isOpened():
                raise PlantError(f"film {str(path)!r} cannot be written: check its folder, rights and space")
            writer.write(picture)
            count += 1
    finally:
        writer.release()
    if count == 0:
        raise PlantError(f"film {str(path)!r} has no pictures: give one or more")
    return count


def _line_to_trocar(page: Picture, start: Array, end: Array) -> None:
    height, width = page.shape[:2]
    inside, first, last = cv2.clipLine((0, 0, width, height), _whole(start), _whole(end))
    if inside:
        cv2.line(page, first, last, TROCAR, 1, cv2.LINE_AA)
        label = (min(max(last[0] + 6, 0), width - 60), min(max(last[1], 16), height - 8))
        cv2.putText(page, "trocar", label, cv2.FONT_HERSHEY_SIMPLEX, 0.45, TROCAR, 1, cv2.LINE_AA)


def _whole(pixel: Array) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))
