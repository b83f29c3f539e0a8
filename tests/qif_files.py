"""QIF 3 documents written by hand, for the tests: the block with a hole of `tests.step_files.bored_block`."""

NAMESPACE = "http://qifstandards.org/xsd/qif3"

_UNITS = {"mm": ("mm", 0.001), "in": ("inch", 0.0254)}
_TOP = [(0, 0, 30), (60, 0, 30), (60, 40, 30), (0, 40, 30)]
_FRONT = [(0, 0, 0), (60, 0, 0), (60, 0, 30), (0, 0, 30)]
_BORE = [(38, 20, 0), (38, 20, 30)]


def bored_block_qif(unit: str = "mm", extra: str = "") -> str:
    """Return features and characteristics of the block: flatness of the top (datum A), size and position of the bore.

    Args:
        unit: primary unit of length.
        extra: further characteristic nominals, and their definitions after a line with ---.
    """
    name, factor = _UNITS[unit]
    faces = {100: ("Plane23", _TOP), 200: ("Plane23", _FRONT), 300: ("Cylinder23", _BORE)}
    topology = "".join(_face(number, kind, corners) for number, (kind, corners) in faces.items())
    nominals, _, definitions = extra.partition("---")
    return f"""<?xml version="1.0" encoding="utf-8"?>
<QIFDocument xmlns="{NAMESPACE}" idMax="2000" versionQIF="3.0.0">
<QPId>6e206109-f027-4a5e-8138-99308066435b</QPId>
<FileUnits><PrimaryUnits>
<PMIAngularUnit><SIUnitName>radian</SIUnitName><UnitName>degree</UnitName>
<UnitConversion><Factor>0.017453292519943</Factor></UnitConversion></PMIAngularUnit>
<LinearUnit><SIUnitName>meter</SIUnitName><UnitName>{name}</UnitName>
<UnitConversion><Factor>{factor}</Factor></UnitConversion></LinearUnit></PrimaryUnits>
<OtherUnits n="1"><LinearUnit><SIUnitName>meter</SIUnitName><UnitName>um</UnitName>
<UnitConversion><Factor>0.000001</Factor></UnitConversion></LinearUnit></OtherUnits></FileUnits>
<DatumDefinitions n="1"><DatumDefinition id="10"><DatumLabel>A</DatumLabel>
<FeatureNominalIds n="1"><Id>1100</Id></FeatureNominalIds></DatumDefinition></DatumDefinitions>
<DatumReferenceFrames n="1"><DatumReferenceFrame id="20"><Datums n="1"><Datum><SimpleDatum>
<DatumDefinitionId>10</DatumDefinitionId></SimpleDatum><Precedence><PrecedenceEnum>PRIMARY</PrecedenceEnum>
</Precedence></Datum></Datums></DatumReferenceFrame></DatumReferenceFrames>
<Product>{topology}</Product>
<Features><FeatureNominals n="3">{_feature(1100, "Plane", 100)}{_feature(1200, "Plane", 200)}
{_feature(1300, "Cylinder", 300)}</FeatureNominals></Features>
<Characteristics><CharacteristicDefinitions n="3">
<FlatnessCharacteristicDefinition id="31"><ToleranceValue linearUnit="um">300</ToleranceValue>
</FlatnessCharacteristicDefinition>
<DiameterCharacteristicDefinition id="32"><Tolerance><MaxValue>16.2</MaxValue><MinValue>15.9</MinValue>
<DefinedAsLimit>true</DefinedAsLimit></Tolerance></DiameterCharacteristicDefinition>
<PositionCharacteristicDefinition id="33"><ToleranceValue>0.4</ToleranceValue>
<DatumReferenceFrameId>20</DatumReferenceFrameId><MaterialCondition>MAXIMUM</MaterialCondition>
<ZoneShape><DiametricalZone/></ZoneShape></PositionCharacteristicDefinition>{definitions}
</CharacteristicDefinitions><CharacteristicNominals n="3">
{characteristic("Flatness", 41, 31, 1100)}
{characteristic("Diameter", 42, 32, 1300, "<TargetValue>16</TargetValue>")}
{characteristic("Position", 43, 33, 1300)}{nominals}
</CharacteristicNominals></Characteristics></QIFDocument>"""


def characteristic(kind: str, number: int, definition: int, feature: int, more: str = "") -> str:
    """Return a nominal characteristic of a feature."""
    return (
        f'<{kind}CharacteristicNominal id="{number}"><CharacteristicDefinitionId>{definition}'
        f'</CharacteristicDefinitionId><FeatureNominalIds n="1"><Id>{feature}</Id></FeatureNominalIds>'
        f"<Name>{kind} {number}</Name>{more}</{kind}CharacteristicNominal>"
    )


def _feature(number: int, kind: str, face: int) -> str:
    return (
        f'<{kind}FeatureNominal id="{number}"><EntityInternalIds n="1"><Id>{face}</Id></EntityInternalIds>'
        f"</{kind}FeatureNominal>"
    )


def _face(number: int, kind: str, corners: list[tuple[int, int, int]]) -> str:
    """Return a face with its loop, edges, vertices and points; the corners are in the unit of the file."""
    n = len(corners)
    points = "".join(
        f'<Point id="{number + 50 + k}"><XYZ>{x} {y} {z}</XYZ></Point>'
        f'<Vertex id="{number + 30 + k}"><Point><Id>{number + 50 + k}</Id></Point></Vertex>'
        for k, (x, y, z) in enumerate(corners)
    )
    edges = "".join(
        f'<Edge id="{number + 10 + k}"><VertexBeg><Id>{number + 30 + k}</Id></VertexBeg>'
        f"<VertexEnd><Id>{number + 30 + (k + 1) % n}</Id></VertexEnd></Edge>"
        for k in range(n)
    )
    ring = "".join(f"<CoEdge><EdgeOriented><Id>{number + 10 + k}</Id></EdgeOriented></CoEdge>" for k in range(n))
    return (
        f'<Face id="{number}"><Surface><Id>{number + 1}</Id></Surface><LoopIds n="1"><Id>{number + 2}</Id></LoopIds>'
        f'</Face><{kind} id="{number + 1}"/><Loop id="{number + 2}"><CoEdges n="{n}">{ring}</CoEdges></Loop>'
        f"{edges}{points}"
    )
