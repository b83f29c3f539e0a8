"""A scanner plug-in: a range finder with a round field of view, whose source and sensor coincide."""

import numpy as np


class RangeFinder:
    source = sensor = np.zeros(3)  # m, scanner frame; z is the viewing axis
    grid_shape = (101, 101)

    def __init__(self, half_angle_deg=25.0, range_mm=(100.0, 600.0)):
        self.half_angle_deg, self.range_mm = half_angle_deg, range_mm

    def parameters(self):
        return {"half_angle_deg": self.half_angle_deg, "range_mm": list(self.range_mm)}

    def ray_directions(self):
        x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 101) * np.tan(np.radians(self.half_angle_deg))])
        rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
        return rays / np.linalg.norm(rays, axis=1)[:, None]

    def reject(self, points, normals):
        distance = np.linalg.norm(points, axis=1)
        near, far = np.array(self.range_mm) / 1000
        code = np.zeros(len(points), dtype=np.uint8)  # values of planner.ports.Rejection; 0 is a measured point
        code[np.einsum("ni,ni->n", points, normals) > -0.3 * distance] = 4  # grazing incidence
        code[(distance < near) | (distance > far)] = 3  # out of range
        code[points[:, 2] < np.cos(np.radians(self.half_angle_deg)) * distance] = 2  # out of view
        return code
