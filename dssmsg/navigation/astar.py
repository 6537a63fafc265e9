"""A* on a grid of costs: the cheapest way over eight neighbours, deterministic among equals."""

from __future__ import annotations

import heapq
import math

from dssmsg.frame import FloatArray

Cell = tuple[int, int]
_DIAGONAL = math.sqrt(2.0)
_STEPS = tuple(
    (dx, dy, _DIAGONAL if dx and dy else 1.0) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy
)


def cheapest_way(cost: FloatArray, start: Cell, goal: Cell) -> tuple[Cell, ...] | None:
    """Cells from `start` to `goal`, both included; None if there is no way.

    cost (n, m): what a step of one cell into each cell costs, at least 1, inf where one must not go. A step
    between two cells that touch at a corner needs both cells beside it passable. The cost of `start` counts
    for nothing. Raises IndexError where an end is outside.
    """
    rows, columns = cost.shape
    for end in (start, goal):
        if not (0 <= end[0] < rows and 0 <= end[1] < columns):
            raise IndexError(f"cell {end} is outside of a grid of {rows} x {columns}")
    price = cost.tolist()  # plain floats: a loop over single cells is slow on arrays
    best = {start: 0.0}
    came_from: dict[Cell, Cell] = {}
    done: set[Cell] = set()
    queue = [(_guess(start, goal), start)]
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == goal:
            return _walk_back(came_from, goal)
        if cell in done:
            continue
        done.add(cell)
        x, y = cell
        for dx, dy, length in _STEPS:
            i, j = x + dx, y + dy
            if not (0 <= i < rows and 0 <= j < columns) or price[i][j] == math.inf:
                continue
            if dx and dy and (price[x][j] == math.inf or price[i][y] == math.inf):
                continue
            total = best[cell] + length * price[i][j]
            if total < best.get((i, j), math.inf):
                best[i, j] = total
                came_from[i, j] = cell
                heapq.heappush(queue, (total + _guess((i, j), goal), (i, j)))
    return None


def _guess(cell: Cell, goal: Cell) -> float:
    """The least that the rest can cost: eight-connected distance at the price 1."""
    dx, dy = abs(cell[0] - goal[0]), abs(cell[1] - goal[1])
    return max(dx, dy) + (_DIAGONAL - 1.0) * min(dx, dy)


def _walk_back(came_from: dict[Cell, Cell], goal: Cell) -> tuple[Cell, ...]:
    cells = [goal]
    while cells[-1] in came_from:
        cells.append(came_from[cells[-1]])
    return tuple(reversed(cells))
