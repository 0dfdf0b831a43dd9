"""The display while the study runs: its progress, and the answer so far."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console, RenderableType

from benchmarks.common.answer import Answer
from benchmarks.solver_study.first_screen import answer
from moc_opt.report.console import Bar


class Progress:
    """Collects what parts of the study find, and shows it.

    Args:
        weights: part -> seconds that one of its batches of jobs takes, roughly.
        screen: where a headline that changed is printed, when it is no terminal; a terminal shows `below`.
        deadline_us: of a tick.
    """

    def __init__(self, weights: Mapping[str, float], screen: Console, deadline_us: float) -> None:
        self._weights, self._screen, self._deadline_us = weights, screen, deadline_us
        self._weight, self._summary, self._said = 0.0, dict[str, Any](), ""
        self._answer: Answer | None = None
        self.bar: Bar | None = None

    def enter(self, part: str) -> None:
        """Note that a part begins."""
        self._weight = self._weights.get(part, 0.0)

    def advance(self, text: str, share: float = 1.0) -> None:
        """Count a share of a batch of the part's jobs, and say whose it was."""
        if self.bar is not None:
            self.bar.at(text)
            self.bar.advance(self._weight * share)

    def show(self, parts: Mapping[str, Any]) -> None:
        """Take in parts of the summary, as far as they have come."""
        self._summary = {**self._summary, **parts}
        self._answer = answer(self._summary, self._deadline_us, drawn=False)
        said = self._answer.sentences[0]
        if not self._screen.is_terminal and said != self._said and self._stands():
            self._said = said
            self._screen.print(f"so far: {said}", markup=False)

    def _stands(self) -> bool:
        """Return whether every solver has answered the certified sets: before that the best one is not known."""
        answered = {name.removesuffix("@recommended") for name in self._summary.get("testsets", {})}
        return bool(answered) and set(self._summary.get("open_loop_warm", {})) <= answered

    def below(self) -> Iterable[RenderableType]:
        """Yield the answer so far, for a terminal."""
        if self._answer is not None:
            yield self._answer.sentences[0]
            yield self._answer.table.narrowed(self._screen.width)

    def interrupted(self, screen: Console) -> None:
        """Print what is known when the study is stopped."""
        if self._answer is not None:
            screen.print("As far as the study has come:")
            for part in self._answer.screens(screen.width):
                screen.print(part, markup=False)
