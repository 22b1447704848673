"""Heights on a grid as MuJoCo's files have them, their tiles and a coarser grid of them."""

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

    def coarser(self, factor: int, below_m: float = 0.0) -> HeightField:
        """A grid of cells `factor` times as wide, `below_m` below the heights at its vertices.

        It has the last heights of this one beyond its end. An upper envelope would reach out over
        steps by the width of its cells, and the trunk of a robot would drag there.
        """
        rows, columns = ([*range(0, n - 1, factor), n - 1] for n in self.heights_m.shape)
        cell = (self.cell_m[0] * factor, self.cell_m[1] * factor)
        return HeightField(self.origin_m, cell, self.heights_m[np.ix_(rows, columns)] - below_m)


def read_height_field(path: Path, size: Sequence[float], position: Sequence[float]) -> HeightField:
    """The height field of a file of MuJoCo, whose geom has a size and a position."""
    data = path.read_bytes()
    rows, columns = np.frombuffer(data, "<i4", 2)
    shares = np.frombuffer(data, "<f4", int(rows) * int(columns), 8)
    heights = position[2] + size[2] * shares.astype(float).reshape(rows, columns)
    cell = (2 * size[0] / (columns - 1), 2 * size[1] / (rows - 1))
    return HeightField((position[0] - size[0], position[1] - size[1]), cell, heights)
