"""Mug: a deep open cavity and a handle to reach through (genus 1). z is up, the handle points to +x."""

import numpy as np

from cell.stand_ins.fields import Field, cylinder, displaced, revolve, ripples, tube, union, without


def field(rng: np.random.Generator) -> Field:
    """The mug in its box of 60 x 50 x 47 mm; the body's axis is z."""
    along = [0.0, 1.0, 4.0, 12.0, 24.0, 38.0, 47.0]
    outside = revolve(2, along, [21.0, 22.6, 23.8, 24.6, 25.0, 24.6, 24.2])
    angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
    loop = [(23.0 + 9.2 * np.cos(t), 0.0, 24.5 + 13.5 * np.sin(t)) for t in angle]
    radii = 2.35 + 0.9 * np.abs(np.sin(angle)) ** 6  # the handle grows thicker where it meets the wall
    handle = tube(loop, list(radii), blend=0.4)
    cavity = union(2.0, cylinder((0, 0, 4.0), (0, 0, 60.0), 21.6, 4.0), cylinder((0, 0, 44.5), (0, 0, 62.0), 22.0, 1.0))
    foot = cylinder((0, 0, -5.0), (0, 0, 1.2), 18.0, 0.5)
    body = union(1.5, outside, handle)
    return displaced(without(1.2, body, cavity, foot), ripples(rng, 0.06, 14.0))
