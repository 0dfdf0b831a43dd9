"""Settings of the augmented reality: the endoscope's camera, the marker board, what hides it, and the tracker."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Settings
from moc_opt.vision.board import Board
from moc_opt.vision.tracking import TrackerLimits


class CameraSettings(Settings):
    """An endoscope that looks at the phantom through a port of its own; its pictures are taken as undistorted.

    Raises:
        PlantError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    KIND: ClassVar[str] = "[camera]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

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


class BoardSettings(Settings):
    """The marker board in the phantom, and what keeps it from being seen.

    Raises:
        PlantError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    KIND: ClassVar[str] = "[board]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

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
        """The board that they describe."""
        return Board(self.columns, self.rows, self.marker_m, self.gap_m)

    def is_lost(self, t: float) -> bool:
        """Whether nothing of the board can be seen at time t [s]."""
        return any(start <= t < end for start, end in self.lost_s)


class TrackerSettings(Settings):
    """When a sighting of the board is believed; see `moc_opt.vision.tracking.TrackerLimits`.

    Raises:
        PlantError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    KIND: ClassVar[str] = "[tracker]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

    min_markers: int = Field(3, ge=1)
    error_max_px: float = Field(1.0, gt=0.0)
    jump_m: float = Field(0.004, gt=0.0)
    jump_rad: float = Field(0.05, gt=0.0)
    found_after: int = Field(3, ge=1, description="sightings in a row that agree")
    lost_after_s: float = Field(0.12, gt=0.0)
    smoothing_s: float = Field(0.3, ge=0.0)

    def limits(self) -> TrackerLimits:
        """As the tracker takes them."""
        return TrackerLimits(**self.model_dump())
