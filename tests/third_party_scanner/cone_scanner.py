"""A range finder with a round field of view, as another distribution's scanner: no baseline, hence no shadow."""

import numpy as np


class Cone:
    source = sensor = np.zeros(3)
    grid_shape = (1, 1)

    def __init__(self, half_angle_deg=25.0, range_mm=(100.0, 600.0)):
        self.half_angle_deg, self.range_mm = half_angle_deg, tuple(range_mm)

    def parameters(self):
        return {"half_angle_deg": self.half_angle_deg, "range_mm": list(self.range_mm)}

    def ray_directions(self):
        return np.array([[0.0, 0.0, 1.0]])

    def reject(self, points, normals):
        distance = np.linalg.norm(points, axis=1)
        near, far = np.array(self.range_mm) / 1000
        codes = np.where(np.einsum("ni,ni->n", points, normals) < -0.3 * distance, 0, 4)  # 4: grazing, 3: out of range,
        codes[~((distance >= near) & (distance <= far))] = 3  # 2: out of view (planner.ports.Rejection)
        codes[points[:, 2] < np.cos(np.radians(self.half_angle_deg)) * distance] = 2
        return codes.astype(np.uint8)
