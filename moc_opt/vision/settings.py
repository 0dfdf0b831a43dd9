"""Settings of the augmented reality: the endoscope's camera, the marker board, its covers, and the tracker."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Settings
from moc_opt.vision.board import Board


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

    source: Literal["auto", "mujoco", "drawn"] = Field(
        "auto", description="MuJoCo's renderer, a picture drawn through the pinhole, or the first that works"
    )
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


class BoardSettings(VisionSettings):
    """The marker board in the phantom, and the times and covers that hide it."""

    KIND: ClassVar[str] = "[board]"

    columns: int = Field(5, ge=1, le=20)
    rows: int = Field(4, ge=1, le=20)
    marker_m: float = Field(0.020, gt=0.0, le=0.5, description="side of a marker")
    gap_m: float = Field(0.005, gt=0.0, le=0.5, description="white space between markers, and around them")
    hidden_fraction: float = Field(0.0, ge=0.0, le=1.0, description="of the markers, covered by something")
    lost_s: tuple[tuple[float, float], ...] = Field(
        (), description="[from, until] in seconds: nothing of the board can be seen"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for start, end in self.lost_s:
            if not 0.0 <= start < end:
                raise ValueError(f"lost_s = {[start, end]}: give [from, until] with 0 <= from < until")
        if self.columns * self.rows > 250:
            raise ValueError(f"columns x rows = {self.columns * self.rows}: the dictionary has 250 markers")
        return self

    def board(self) -> Board:
        """Return the board that they describe."""
        return Board(self.columns, self.rows, self.marker_m, self.gap_m)

    def is_lost(self, t: float) -> bool:
        """Return whether nothing of the board can be seen at time t [s]."""
        return any(start <= t < end for start, end in self.lost_s)


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
