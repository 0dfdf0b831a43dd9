"""What can go wrong while something is reported."""

from __future__ import annotations

from moc_opt.errors import MocOptError


class ReportError(MocOptError, ValueError):
    """A table, figure or page cannot be made from these data, or not be written."""


class BrowserError(ReportError):
    """No browser can be driven here; the message holds what to install."""
