"""Settings of the endoscope's camera and of the tracker; those of the board are `Board`."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Settings


class VisionSettings(Settings):
    """Base of the tables below.

    Raises:
        PlantError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    ERROR: ClassVar[type[MocOptError]] = PlantError


class CameraSettings(VisionSettings):
    """An endoscope that looks at the phantom through a port of its own; its pictures are taken as undistorted."""

    KIND: ClassVar[str] = "[camera]"

    width_px: int = Field(640, ge=64, le=4096)
    height_px: int = Field(480, ge=64, le=4096)
    fov_deg: float = Field(50.0, ge=10.0, le=120.0, description="angle of view from top to bottom")
    rate_Hz: float = Field(30.0, gt=0.0, le=500.0, description="pictures in a second")
    distance_m: float = Field(0.16, ge=0.02, le=1.0, description="from the middle of the phantom's board")
    tilt_deg: float = Field(25.0, ge=0.0, le=75.0, description="of the line of sight from the board's normal")
    azimuth_deg: float = Field(-90.0, description="where it stands around the normal, from the board's x")
    blur_px: float = Field(0.7, ge=0.0, le=10.0, description="standard deviation of the lens's blur")
    noise: float = Field(3.0, ge=0.0, le=100.0, description="standard deviation, in grey levels of 255")
    calibration_error_m: float = Field(
        0.0005, ge=0.0, le=0.05, description="the camera is this far from where the robot takes it to be"
    )
    calibration_error_deg: float = Field(0.1, ge=0.0, le=10.0, description="and turned by this")


class TrackerSettings(VisionSettings):
    """When a sighting of the board is believed."""

    KIND: ClassVar[str] = "[tracker]"

    min_markers: int = Field(3, ge=1, description="fewer than this are no sighting")
    error_max_px: float = Field(1.0, gt=0.0, description="a worse fit is no sighting")
    jump_m: float = Field(0.004, gt=0.0, description="a sighting farther than this from the estimate is an outlier")
    jump_rad: float = Field(0.05, gt=0.0, description="and so is one turned by more")
    found_after: int = Field(3, ge=1, description="sightings in a row that agree: the board is found, or was moved")
    lost_after_s: float = Field(0.12, gt=0.0, description="without a sighting: the board is lost")
    smoothing_s: float = Field(0.3, ge=0.0, description="time constant of the estimate; 0: every sighting as it is")
