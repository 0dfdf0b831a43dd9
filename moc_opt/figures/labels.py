"""Names beside points: placed so that they cover neither each other nor a point."""

from __future__ import annotations

from collections.abc import Collection, Mapping

Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px], y downwards."""

CHARACTER_PX, LINE_PX, MARKER_PX = 6.3, 14.0, 7.0
TOLERATED_PX2, SHYNESS_PX2 = 25.0, 20.0


def label_sides(points: Mapping[str, tuple[float, float]], front: Collection[str] = ()) -> dict[str, str | None]:
    """Choose on which side of its point each name stands, in plotly's words.

    Greedy: the names of `front` choose first, then the others in their order; each takes the side where it covers
    least of the drawn points.

    Args:
        points: name -> place of the point [px], y downwards.
        front: names on a line that runs above and to the right of its points: they would rather stand below.

    Returns:
        Name -> "top center" and the like; None where there is no room.
    """
    markers = {name: (x - MARKER_PX, y - MARKER_PX, x + MARKER_PX, y + MARKER_PX) for name, (x, y) in points.items()}
    placed: list[Box] = []
    sides: dict[str, str | None] = {}
    for name in sorted(points, key=lambda name: name not in front):
        taken = [*placed, *(box for other, box in markers.items() if other != name)]
        boxes = _boxes(name, *points[name])
        covered = {side: sum(_shared(box, other) for other in taken) for side, box in boxes.items()}
        if name in front:
            covered = {side: area + SHYNESS_PX2 * ("bottom" not in side) for side, area in covered.items()}
        best = min(covered, key=lambda side: covered[side])
        if covered[best] > TOLERATED_PX2:
            sides[name] = None
            continue
        placed.append(boxes[best])
        sides[name] = best
    return sides


def _boxes(name: str, x: float, y: float) -> dict[str, Box]:
    """Return side -> the rectangle that the name would take there, the sides we like best first."""
    wide, near, far = CHARACTER_PX * len(name), MARKER_PX + 1.0, MARKER_PX + 1.0 + LINE_PX
    left, right = (x - near - wide, x - near), (x + near, x + near + wide)
    centre, middle = (x - wide / 2, x + wide / 2), (y - LINE_PX / 2, y + LINE_PX / 2)
    above, below = (y - far, y - near), (y + near, y + far)
    spans = {
        "top center": (centre, above), "bottom center": (centre, below), "middle right": (right, middle),
        "middle left": (left, middle), "top right": (right, above), "bottom right": (right, below),
        "top left": (left, above), "bottom left": (left, below),
    }  # fmt: skip
    return {side: (across[0], down[0], across[1], down[1]) for side, (across, down) in spans.items()}


def _shared(one: Box, two: Box) -> float:
    """Return the area that two rectangles have in common [px^2]."""
    wide, tall = min(one[2], two[2]) - max(one[0], two[0]), min(one[3], two[3]) - max(one[1], two[1])
    return max(wide, 0.0) * max(tall, 0.0)
