"""A source of points for `cell scan --acquire wall:MM`: a flat wall before the scanner."""

import numpy as np

from cell.scan.acquisition import Acquired


class Wall:
    def __init__(self, argument, context):
        self.distance, self.source = float(argument) / 1000, f"a wall at {argument} mm"

    def take(self, view):
        x, y = np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9))
        return Acquired(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, self.distance)]), "scanner")
