"""Heights on a grid as MuJoCo's files have them, their tiles and their upper envelope."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class HeightField:
    """Heights at the vertices of a grid; row of least y first."""

    origin_m: tuple[float, float]
    cell_m: tuple[float, float]
    heights_m: np.ndarray

    def tiles(self, cells: int) -> list[HeightField]:
        """Parts of at most `cells` cells each way that share their border vertices."""
        rows, columns = self.heights_m.shape
        found = []
        for row in range(0, rows - 1, cells):
            for column in range(0, columns - 1, cells):
                origin = (
                    self.origin_m[0] + column * self.cell_m[0],
                    self.origin_m[1] + row * self.cell_m[1],
                )
                heights = self.heights_m[row : row + cells + 1, column : column + cells + 1]
                found.append(HeightField(origin, self.cell_m, heights))
        return found

    def upper_envelope(self, factor: int) -> HeightField:
        """A grid of cells `factor` times as wide that is nowhere below this one."""
        rows, columns = self.heights_m.shape
        size = [-(-(n - 1) // factor) + 1 for n in (rows, columns)]
        heights = np.empty(size)
        for row in range(size[0]):
            # A vertex bears on all cells around it.
            y = slice(max(0, (row - 1) * factor), (row + 1) * factor + 1)
            for column in range(size[1]):
                x = slice(max(0, (column - 1) * factor), (column + 1) * factor + 1)
                heights[row, column] = self.heights_m[y, x].max()
        cell = (self.cell_m[0] * factor, self.cell_m[1] * factor)
        return HeightField(self.origin_m, cell, heights)


def read_height_field(path: Path, size: Sequence[float], position: Sequence[float]) -> HeightField:
    """The height field of a file of MuJoCo, whose geom has a size and a position."""
    data = path.read_bytes()
    rows, columns = np.frombuffer(data, "<i4", 2)
    shares = np.frombuffer(data, "<f4", int(rows) * int(columns), 8)
    heights = position[2] + size[2] * shares.astype(float).reshape(rows, columns)
    cell = (2 * size[0] / (columns - 1), 2 * size[1] / (rows - 1))
    return HeightField((position[0] - size[0], position[1] - size[1]), cell, heights)
