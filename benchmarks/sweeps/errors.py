"""Errors of a whole sweep; a single run that fails is a row, not an error."""

from __future__ import annotations

from moc_opt.errors import MocOptError


class SweepError(MocOptError, ValueError):
    """A sweep's configuration cannot be made into runs."""


class StoreError(MocOptError, OSError):
    """The folder of a sweep cannot be used, read or written."""


class WorkerError(MocOptError, RuntimeError):
    """The processes that should run a sweep cannot be started, reached or kept alive."""
