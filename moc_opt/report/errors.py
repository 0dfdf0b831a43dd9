"""What can go wrong while something is reported."""

from __future__ import annotations

from moc_opt.errors import MocOptError


class ReportError(MocOptError, ValueError):
    """A table, figure or page cannot be made from these data, or not be written."""


class BrowserError(ReportError):
    """A browser cannot be driven here; the message holds the cure."""


class BrowserMissingError(BrowserError):
    """There is none, or nothing to drive it with; the message holds what to install."""
