"""Telegrams of KUKA.RobotSensorInterface (RSI), and the files that a controller needs for `rsi://`.

Every cycle (4 or 12 ms) the controller sends a telegram in XML over UDP with its axes and a clock, `IPOC`. The answer
repeats this clock unchanged and holds the corrections of the axes [deg], absolute from where they were when RSI began.
An answer that arrives after its cycle is rejected; with `HOLDON="1"` the last accepted correction then stays. `Delay`
counts such answers; after `Timeout` of them the controller ends RSI with an error.
"""

import re
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.limits import Limits
from drivers.setpoints import AXES, PER_DEGREE, Floats
from drivers.wires.controller_files import encoded, filled_file

NAME: Final = "sc_rsi"
PORT: Final = 49152
TIMEOUT_CYCLES: Final = 100
"""Unanswered telegrams after which the controller ends RSI."""

SENDER: Final = "ScanCell"
"""Type of the answers."""

_AXES: Final = tuple(f"A{axis}" for axis in range(1, AXES + 1))
_ELEMENT: Final = re.compile(rb"<(\w+)\s+([^<>]*?)/?>")
_ATTRIBUTE: Final = re.compile(rb'(\w+)\s*=\s*"([^"]*)"')
_CLOCK: Final = re.compile(rb"<IPOC>\s*(\d+)\s*</IPOC>")


@dataclass(frozen=True, slots=True, eq=False)
class Telegram:
    """A telegram of the controller.

    Attributes:
        ipoc: clock of the controller [ms].
        axes_deg: (6,) actual axes.
        late: answers that the controller counted as late or wrong.
        applied_deg: (6,) corrections that it has applied since the beginning of RSI; 0 if it does not report them.
    """

    ipoc: int
    axes_deg: Floats
    late: int
    applied_deg: Floats


def parse_telegram(data: bytes) -> Telegram:
    """Return a telegram of the controller.

    Raises:
        ValueError: if it is none, or has no axes.
    """
    clock = _CLOCK.search(data)
    elements = {name: dict(_ATTRIBUTE.findall(rest)) for name, rest in _ELEMENT.findall(data)}
    axes = elements.get(b"AIPos")
    if clock is None or axes is None:
        raise ValueError("a telegram without IPOC or AIPos")
    try:
        degrees = np.array([float(axes[name.encode()]) for name in _AXES])
    except KeyError as error:
        raise ValueError(f"a telegram without axis {error}") from error
    late, applied = elements.get(b"Delay", {}).get(b"D", b"0"), elements.get(b"AxisCorrMon", {})
    corrections = np.array([float(applied.get(name.encode(), b"0")) for name in _AXES])
    return Telegram(int(clock[1]), degrees, int(float(late)), corrections)


def telegram(sent: Telegram) -> bytes:
    """Return a telegram as a controller sends it."""
    axes, applied = (
        " ".join(f'{name}="{angle:.4f}"' for name, angle in zip(_AXES, angles, strict=True))
        for angles in (sent.axes_deg, sent.applied_deg)
    )
    return (
        f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="{sent.late}"/><AxisCorrMon {applied}/>'
        f"<IPOC>{sent.ipoc}</IPOC></Rob>"
    ).encode("ascii")


def answer(ipoc: int, corrections_deg: Floats, *, end: bool) -> bytes:
    """Return the answer to a telegram.

    Args:
        ipoc: clock of the telegram.
        corrections_deg: (6,) corrections from the axes at the beginning of RSI.
        end: end the motion by RSI.
    """
    axes = " ".join(f'{name}="{angle:.6f}"' for name, angle in zip(_AXES, corrections_deg, strict=True))
    return (
        f'<Sen Type="{SENDER}"><EStr></EStr><AKorr {axes}/><MoveStop>{int(end)}</MoveStop><IPOC>{ipoc}</IPOC></Sen>'
    ).encode("ascii")


def parse_answer(data: bytes) -> tuple[int, Floats, bool]:
    """Return clock, corrections [deg] and end of an answer.

    Raises:
        ValueError: if it is none.
    """
    clock, corrections_match = _CLOCK.search(data), re.search(rb"<AKorr ([^>]*)/>", data)
    if clock is None or corrections_match is None:
        raise ValueError("an answer without IPOC or AKorr")
    axes = dict(_ATTRIBUTE.findall(corrections_match[1]))
    corrections = np.array([float(axes[name.encode()]) for name in _AXES])
    return int(clock[1]), corrections, b"<MoveStop>1</MoveStop>" in data


def files(address: str, port: int, limits: Limits, *, cycle_ms: int) -> dict[str, bytes]:
    """Return the files of a controller: program, signal flow, and configuration of the telegrams.

    Args:
        address: of this computer in the network of the controller.
        port: of this computer.
        limits: of the arm; a correction may span the range of its axis.
        cycle_ms: 4 or 12.
    """
    spans = (limits.upper.astype(np.float64) - limits.lower)[:AXES] / PER_DEGREE
    mode = "#ABSOLUTE,#IPO_FAST" if cycle_ms == 4 else "#ABSOLUTE,#IPO"
    return {
        f"{NAME}.src": filled_file(f"{NAME}.src", {"MODE": mode}),
        f"{NAME}.rsi.xml": encoded(_signal_flow(spans)),
        f"{NAME}_ethernet.xml": filled_file(f"{NAME}_ethernet.xml", _configuration(address, port)),
    }


def _configuration(address: str, port: int) -> dict[str, object]:
    """Return the values of the configuration of the telegrams."""
    sent = "".join(
        f'      <ELEMENT TAG="AxisCorrMon.{name}" TYPE="DOUBLE" INDX="{number}" />\n'
        for number, name in enumerate(_AXES, start=1)
    )
    received = "".join(
        f'      <ELEMENT TAG="AKorr.{name}" TYPE="DOUBLE" INDX="{number}" HOLDON="1" />\n'
        for number, name in enumerate(_AXES, start=1)
    )
    return {
        "ADDRESS": address, "PORT_NUMBER": port, "SENDER": SENDER, "SENT": sent, "RECEIVED": received,
        "STOP_INDEX": AXES + 1,
    }  # fmt: skip


def _signal_flow(spans: Floats) -> str:
    def parameter(name: str, number: int, value: object, more: str = "") -> str:
        return f'      <Parameter Name="{name}" ParamID="{number}" ParamValue="{value}"{more} />\n'

    def wires(count: int, first: int, source: str = "ETHERNET1") -> str:
        return "".join(
            f'      <Input InIdx="{k + 1}" OutObjID="{source}" OutIdx="{first + k}" />\n' for k in range(count)
        )

    def element(kind: str, number: int, inputs: str, parameters: str) -> str:
        inner = f"    <Inputs>\n{inputs}    </Inputs>\n" if inputs else ""
        return (
            f'  <RSIObject ObjType="{kind}" ObjTypeID="{number}" ObjID="{kind}1">\n{inner}'
            f"    <Parameters>\n{parameters}    </Parameters>\n  </RSIObject>\n"
        )

    lower = "".join(parameter(f"LowerLimA{k + 1}", k + 1, f"{-span:.4f}") for k, span in enumerate(spans))
    upper = "".join(parameter(f"UpperLimA{k + 1}", k + 13, f"{span:.4f}") for k, span in enumerate(spans))
    monitor = "".join(parameter(f"MaxA{k + 1}", k + 1, f"{span:.4f}") for k, span in enumerate(spans))
    ethernet = (
        parameter("ConfigFile", 1, f"{NAME}_ethernet.xml", ' IsRuntime="false"')
        + parameter("Timeout", 1, TIMEOUT_CYCLES)
        + parameter("Flag", 4, 1)
        + parameter("Precision", 8, 4)
    )
    schema = "/Roboter/Config/System/Common/Schemes/RSIContext.xsd"
    return (
        '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
        f'<RSIObjects xsi:noNamespaceSchemaLocation="{schema}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">\n'
        + element("AXISCORR", 33, wires(AXES, 1), lower + upper)
        + element("STOP", 18, wires(1, AXES + 1), parameter("Mode", 1, 4))
        + element("ETHERNET", 64, wires(AXES, 1, "AXISCORRMON1"), ethernet)
        + element("AXISCORRMON", 82, "", monitor)
        + "</RSIObjects>\n"
    )
