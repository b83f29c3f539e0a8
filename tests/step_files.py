"""STEP files (AP214) written by hand, for the tests: blocks with a round hole through them, and what lies beside."""

import importlib.util
from dataclasses import dataclass, field
from math import pi

import pytest

needs_cascadio = pytest.mark.skipif(
    importlib.util.find_spec("cascadio") is None, reason="cascadio is not installed: pip install 'scan-cell[step]'"
)

_UNITS = {
    "mm": "(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))",
    "in": "(CONVERSION_BASED_UNIT('INCH',{measure})LENGTH_UNIT()NAMED_UNIT({dimensions}))",
}


@dataclass
class StepFile:
    """Entities of one product; lengths are in its own unit."""

    unit: str = "mm"
    lines: list[str] = field(default_factory=list)
    solids: list[str] = field(default_factory=list)
    others: list[tuple[str, str, str]] = field(default_factory=list)
    colours: list[tuple[str, tuple[float, float, float]]] = field(default_factory=list)

    def add(self, entity: str) -> str:
        """The reference of a new entity."""
        self.lines.append(entity)
        return f"#{len(self.lines)}"

    def point(self, *xyz: float) -> str:
        return self.add(f"CARTESIAN_POINT('',({_numbers(xyz)}))")

    def direction(self, *xyz: float) -> str:
        return self.add(f"DIRECTION('',({_numbers(xyz)}))")

    def axes(self, at: tuple[float, ...], z: tuple[float, ...], x: tuple[float, ...]) -> str:
        return self.add(f"AXIS2_PLACEMENT_3D('',{self.point(*at)},{self.direction(*z)},{self.direction(*x)})")

    def vertex(self, *xyz: float) -> str:
        return self.add(f"VERTEX_POINT('',{self.point(*xyz)})")

    def straight(self, a: tuple[float, ...], b: tuple[float, ...], va: str, vb: str) -> str:
        way = [q - p for p, q in zip(a, b, strict=True)]
        length = sum(w * w for w in way) ** 0.5
        vector = self.add(f"VECTOR('',{self.direction(*(w / length for w in way))},{length:.12E})")
        line = self.add(f"LINE('',{self.point(*a)},{vector})")
        return self.add(f"EDGE_CURVE('',{va},{vb},{line},.T.)")

    def bound(self, edges: list[tuple[str, bool]], kind: str = "FACE_BOUND") -> str:
        turned = [self.add(f"ORIENTED_EDGE('',*,*,{edge},{'.T.' if way else '.F.'})") for edge, way in edges]
        loop = self.add(f"EDGE_LOOP('',({','.join(turned)}))")
        return self.add(f"{kind}('',{loop},.T.)")

    def block(
        self, low: tuple[float, float, float], high: tuple[float, float, float], hole: tuple[float, float, float] | None
    ) -> None:
        """A block as a solid; `hole` is x, y and radius of one along z through it."""
        self.solids.append(self.add(f"MANIFOLD_SOLID_BREP('',{self._shell(low, high, hole, 'CLOSED_SHELL')})"))

    def _shell(self, low: tuple[float, ...], high: tuple[float, ...], hole: tuple[float, ...] | None, kind: str) -> str:
        corner = {
            (i, j, k): ((low, high)[i][0], (low, high)[j][1], (low, high)[k][2])
            for i in (0, 1) for j in (0, 1) for k in (0, 1)
        }  # fmt: skip
        vertex = {at: self.vertex(*place) for at, place in corner.items()}
        edges: dict[tuple[tuple[int, ...], tuple[int, ...]], str] = {}

        def edge(a: tuple[int, int, int], b: tuple[int, int, int]) -> tuple[str, bool]:
            first, last = sorted((a, b))
            if (first, last) not in edges:
                edges[first, last] = self.straight(corner[first], corner[last], vertex[first], vertex[last])
            return edges[first, last], (first, last) == (a, b)

        round_edges = self._round(low, high, hole) if hole else None
        faces = []
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for side in (0, 1):
                ring = [_at(axis, side, u, i, v, j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
                ring = ring if side else ring[::-1]
                bounds = [
                    self.bound([edge(a, b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)], "FACE_OUTER_BOUND")
                ]
                if round_edges and axis == 2:
                    bounds.append(self.bound([(round_edges[side], not side)]))
                normal = [0.0, 0.0, 0.0]
                normal[axis] = 2.0 * side - 1
                across = [0.0, 0.0, 0.0]
                across[u] = 1.0
                plane = self.add(f"PLANE('',{self.axes(corner[ring[0]], tuple(normal), tuple(across))})")
                faces.append(self.add(f"ADVANCED_FACE('',({','.join(bounds)}),{plane},.T.)"))
        if round_edges and hole:
            below, above, seam = round_edges
            bounds = [self.bound([(below, True), (seam, True), (above, False), (seam, False)], "FACE_OUTER_BOUND")]
            axes = self.axes((hole[0], hole[1], low[2]), (0, 0, 1), (1, 0, 0))
            surface = self.add(f"CYLINDRICAL_SURFACE('',{axes},{hole[2]:.12E})")
            faces.append(self.add(f"ADVANCED_FACE('',({','.join(bounds)}),{surface},.F.)"))
        return self.add(f"{kind}('',({','.join(faces)}))")

    def _round(self, low: tuple[float, ...], high: tuple[float, ...], hole: tuple[float, ...]) -> tuple[str, str, str]:
        """The circles below and above, and the seam between them."""
        x, y, radius = hole
        ends, circles = [], []
        for z in (low[2], high[2]):
            ends.append(self.vertex(x + radius, y, z))
            circle = self.add(f"CIRCLE('',{self.axes((x, y, z), (0, 0, 1), (1, 0, 0))},{radius:.12E})")
            circles.append(self.add(f"EDGE_CURVE('',{ends[-1]},{ends[-1]},{circle},.T.)"))
        seam = self.straight((x + radius, y, low[2]), (x + radius, y, high[2]), *ends)
        return circles[0], circles[1], seam

    def cylinder(self, radius: float, height: float) -> str:
        """A solid cylinder about the z axis."""
        below, above, seam = self._round((0, 0, 0), (0, 0, height), (0, 0, radius))
        faces = []
        for edge, z, side in ((below, 0.0, -1), (above, height, 1)):
            plane = self.add(f"PLANE('',{self.axes((0, 0, z), (0, 0, side), (1, 0, 0))})")
            faces.append(
                self.add(f"ADVANCED_FACE('',({self.bound([(edge, side > 0)], 'FACE_OUTER_BOUND')}),{plane},.T.)")
            )
        bound = self.bound([(below, True), (seam, True), (above, False), (seam, False)], "FACE_OUTER_BOUND")
        surface = self.add(f"CYLINDRICAL_SURFACE('',{self.axes((0, 0, 0), (0, 0, 1), (1, 0, 0))},{radius:.12E})")
        faces.append(self.add(f"ADVANCED_FACE('',({bound}),{surface},.T.)"))
        shell = self.add(f"CLOSED_SHELL('',({','.join(faces)}))")
        self.solids.append(self.add(f"MANIFOLD_SOLID_BREP('',{shell})"))
        return self.solids[-1]

    def tessellated_block(self, high: tuple[float, float, float], link: str = "$") -> str:
        """A block of triangles from the origin, by itself or as the copy of a solid."""
        corners = [(x * high[0], y * high[1], z * high[2]) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
        listed = ",".join(f"({_numbers(corner)})" for corner in corners)
        points = self.add(f"COORDINATES_LIST('',8,({listed}))")
        quads = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]
        faces = [
            self.add(f"TRIANGULATED_FACE('',{points},8,(),$,(),(({a},{b},{c}),({a},{c},{d})))") for a, b, c, d in quads
        ]
        return self.add(f"TESSELLATED_SOLID('',({','.join(faces)}),{link})")

    def sheet_on(self, *places: tuple[float, float, float]) -> str:
        """A polygon in a plane z = const that bounds nothing."""
        vertices = [self.vertex(*place) for place in places]
        n = len(places)
        edges = [
            (self.straight(places[k], places[(k + 1) % n], vertices[k], vertices[(k + 1) % n]), True) for k in range(n)
        ]
        plane = self.add(f"PLANE('',{self.axes(places[0], (0, 0, 1), (1, 0, 0))})")
        face = self.add(f"ADVANCED_FACE('',({self.bound(edges, 'FACE_OUTER_BOUND')}),{plane},.T.)")
        shell = self.add(f"OPEN_SHELL('',({face}))")
        return self.add(f"SHELL_BASED_SURFACE_MODEL('',({shell}))")

    def open_sheet(self, low: tuple[float, float, float], size: float) -> None:
        """A square that bounds nothing, as datum targets are drawn."""
        x, y, z = low
        model = self.sheet_on((x, y, z), (x + size, y, z), (x + size, y + size, z), (x, y + size, z))
        self.others.append(("MANIFOLD_SURFACE_SHAPE_REPRESENTATION", model, "sheet"))

    def text(self) -> str:
        """The file."""
        if self.unit == "in":
            dimensions = self.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
            mm = self.add(_UNITS["mm"])
            measure = self.add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),{mm})")
            length = self.add(_UNITS["in"].format(measure=measure, dimensions=dimensions))
        else:
            length = self.add(_UNITS["mm"])
        angle = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
        solid_angle = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
        sure = self.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-6),{length},'distance_accuracy_value','')")
        context = self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({sure}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid_angle}))REPRESENTATION_CONTEXT('',''))"
        )
        self._product("part", "ADVANCED_BREP_SHAPE_REPRESENTATION", self.solids, context)
        for item, colour in self.colours:
            self._colour(item, colour, context)
        for kind, item, name in self.others:
            self._product(name, kind, [item], context)
        body = "\n".join(f"#{k + 1}={line};" for k, line in enumerate(self.lines))
        return (
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
            "FILE_NAME('part','2026-01-01T00:00:00',(''),(''),'','','');\n"
            "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
            f"{body}\nENDSEC;\nEND-ISO-10303-21;\n"
        )

    def _colour(self, item: str, colour: tuple[float, float, float], context: str) -> None:
        """Red, green and blue, 0 to 1, of a face or a solid."""
        rgb = self.add(f"COLOUR_RGB('',{_numbers(colour)})")
        area = self.add(f"FILL_AREA_STYLE_COLOUR('',{rgb})")
        fill = self.add(f"FILL_AREA_STYLE('',({area}))")
        filled = self.add(f"SURFACE_STYLE_FILL_AREA({fill})")
        side = self.add(f"SURFACE_SIDE_STYLE('',({filled}))")
        used = self.add(f"SURFACE_STYLE_USAGE(.BOTH.,{side})")
        style = self.add(f"PRESENTATION_STYLE_ASSIGNMENT(({used}))")
        styled = self.add(f"STYLED_ITEM('color',({style}),{item})")
        self.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',({styled}),{context})")

    def _product(self, name: str, kind: str, items: list[str], context: str) -> None:
        application = self.add("APPLICATION_CONTEXT('automotive_design')")
        self.add(f"APPLICATION_PROTOCOL_DEFINITION('','automotive_design',2000,{application})")
        product_context = self.add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
        product = self.add(f"PRODUCT('{name}','{name}','',({product_context}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        definition_context = self.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
        definition = self.add(f"PRODUCT_DEFINITION('design','',{formation},{definition_context})")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
        origin = self.axes((0, 0, 0), (0, 0, 1), (1, 0, 0))
        representation = self.add(f"{kind}('{name}',({','.join([origin, *items])}),{context})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{representation})")


def _at(axis: int, side: int, u: int, i: int, v: int, j: int) -> tuple[int, int, int]:
    found = {axis: side, u: i, v: j}
    return found[0], found[1], found[2]


def _numbers(values: tuple[float, ...]) -> str:
    return ",".join(f"{value:.12E}" for value in values)


def bored_block(unit: str = "mm") -> str:
    """A block of 60 x 40 x 30 with a hole of diameter 16 at its middle, its lowest corner at the origin."""
    file = StepFile(unit)
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    return file.text()


BLOCK_VOLUME = 60 * 40 * 30 - pi * 8**2 * 30
"""Of `bored_block`, cubic units."""
