"""The KRL program that `kvp://` needs on a KUKA controller: it executes the orders that a client writes as variables.

| variable | writer | meaning |
|---|---|---|
| `SC_POINT[n]` | client | via point n, with the session and the number of its move |
| `SC_ORDER` | client | the order: session, number, kind (1 move, 2 reset), number of via points, speed [%] |
| `SC_TAKE` | client | a session that asks for the arm; negative: that gives it back |
| `SC_HALT`, `SC_HALTER` | client | number of a stop, and its session, which is written first |
| `$TIMER[n]` | client | minus the watchdog [ms], as heartbeat |
| `SC_STATE` | program | see below |

`SC_STATE` holds the number of starts, the owner, the last answered order with its result, the last ended move with its
result, the current move, its passed via points, and the latched fault.

The program sets `SC_ORDER.NUMBER`, `SC_TAKE` and `SC_HALT` to 0 when it has read them. It executes an order once, if
it is of the owner and newer than the last one, and a move only if all of its via points are written. Three interrupts
brake a moving arm: a stop, the flag of the timer, which rises when the heartbeat ends, and the emergency stop. `RESUME`
then leaves the motion, if the program runs. The components of `SC_STATE` are written in an order in which a
reading between two of them is consistent.
"""

from typing import Final

from drivers.contract import LAST_SEQUENCE, Fault, Result

NAME: Final = "sc_kvp"
MAX_VIA: Final = 500
MOVE, RESET = 1, 2
TIMER: Final = 10
"""Default number of the watchdog's timer."""

_STATE = ("BOOT", "OWNER", "ACK", "RESULT", "DONE", "ENDING", "RUNNING", "PASSED", "FAULT")


def files(timer: int = TIMER) -> dict[str, bytes]:
    """Return the files of the program.

    Args:
        timer: number of the watchdog's timer, 1 to 32.
    """
    return {f"{NAME}.src": _encoded(_source(timer)), f"{NAME}.dat": _encoded(_DATA)}


def _encoded(text: str) -> bytes:
    return text.lstrip("\n").replace("\n", "\r\n").encode("ascii")


def _source(timer: int) -> str:
    numbers = {
        "TIMER": timer, "MAX_VIA": MAX_VIA, "RESET": RESET, "LAST": LAST_SEQUENCE, "HALF": LAST_SEQUENCE // 2,
        **{f"R_{result.name}": int(result) for result in Result},
        **{f"F_{fault.name}": int(fault) for fault in Fault},
    }  # fmt: skip
    text = _PROGRAM
    for name, number in numbers.items():
        text = text.replace(f"<{name}>", str(number))
    return text


_DATA = f"""
&ACCESS RVP
&REL 1
DEFDAT SC_KVP PUBLIC
; variables of the client kvp:// of scan-cell
EXT BAS (BAS_COMMAND :IN,REAL :IN )
GLOBAL STRUC SC_ORDER_T INT SESSION,NUMBER,KIND,COUNT,SPEED
GLOBAL STRUC SC_POINT_T INT SESSION,NUMBER,E6AXIS AXES
GLOBAL STRUC SC_STATE_T INT {",".join(_STATE)}
; written by the client: order, via points, request for the arm, stop and its session
DECL GLOBAL SC_ORDER_T SC_ORDER={{SESSION 0,NUMBER 0,KIND 0,COUNT 0,SPEED 0}}
DECL GLOBAL SC_POINT_T SC_POINT[{MAX_VIA}]
DECL GLOBAL INT SC_TAKE=0
DECL GLOBAL INT SC_HALT=0
DECL GLOBAL INT SC_HALTER=0
; written by the program
DECL GLOBAL SC_STATE_T SC_STATE={{{",".join(f"{name} 0" for name in _STATE)}}}
ENDDAT
"""

_PROGRAM = """
&ACCESS RVP
&REL 1
DEF SC_KVP( )
DECL INT I
; executes the orders of the client kvp:// of scan-cell; start it in T1, T2 or AUT and leave it running
;FOLD INI
;FOLD BASISTECH INI
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
;ENDFOLD (BASISTECH INI)
;ENDFOLD (INI)
; a start ends all earlier orders; one that an owner did not expect is a fault
IF SC_STATE.OWNER<>0 THEN
   SC_STATE.FAULT=<F_RESTARTED>
ENDIF
SC_STATE.BOOT=SC_STATE.BOOT+1
IF SC_STATE.BOOT><LAST> THEN
   SC_STATE.BOOT=1
ENDIF
SC_STATE.OWNER=0
SC_STATE.RUNNING=0
SC_STATE.DONE=0
SC_STATE.ENDING=0
SC_STATE.ACK=0
SC_STATE.RESULT=0
SC_STATE.PASSED=0
SC_ORDER.NUMBER=0
SC_TAKE=0
SC_HALT=0
FOR I=1 TO <MAX_VIA>
   SC_POINT[I].NUMBER=0
ENDFOR
; no advance run; every motion ends in an exact stop
$ADVANCE=0
; block coincidence without motion
PTP $AXIS_ACT
; heartbeat of the client: the timer counts up, its flag is TRUE above 0
$TIMER[<TIMER>]=0
$TIMER_STOP[<TIMER>]=FALSE
INTERRUPT DECL 20 WHEN SC_HALT<>0 DO SC_BRAKE( )
INTERRUPT DECL 21 WHEN $TIMER_FLAG[<TIMER>]==TRUE DO SC_BRAKE( )
INTERRUPT DECL 22 WHEN $ALARM_STOP==FALSE DO SC_ALARM( )
LOOP
   SC_DEAF( )
   IF (SC_STATE.RUNNING<>0) AND (SC_HALT==0) THEN
      ; the motion was left for an emergency stop, or because the heartbeat ended
      IF SC_STATE.FAULT==0 THEN
         SC_STATE.FAULT=<F_WATCHDOG>
      ENDIF
      SC_ENDED(<R_FAULTED>)
   ENDIF
   IF SC_HALT<>0 THEN
      SC_STOPPED( )
   ENDIF
   IF SC_TAKE<>0 THEN
      SC_SESSION( )
   ENDIF
   IF SC_ORDER.NUMBER<>0 THEN
      SC_EXECUTE( )
   ENDIF
   WAIT SEC 0.012
ENDLOOP
END

DEF SC_BRAKE( )
; interrupt: brake on the path, and leave the motion for the loop of the main program
SC_DEAF( )
BRAKE
WAIT FOR $ROB_STOPPED
RESUME
END

DEF SC_ALARM( )
; interrupt: an emergency stop ends the motion
SC_STATE.FAULT=<F_EMERGENCY_STOP>
SC_BRAKE( )
END

DEF SC_DEAF( )
INTERRUPT OFF 20
INTERRUPT OFF 21
INTERRUPT OFF 22
END

DEF SC_ENDED(CAUSE :IN )
DECL INT CAUSE
; end of the current move
SC_STATE.ENDING=CAUSE
SC_STATE.DONE=SC_STATE.RUNNING
SC_STATE.RUNNING=0
END

DEF SC_STOPPED( )
; a stop: of the owner with a number, of another client without, which ends the session
IF SC_HALTER==SC_STATE.OWNER THEN
   IF SC_STATE.RUNNING<>0 THEN
      SC_ENDED(<R_STOPPED>)
   ENDIF
   SC_STATE.RESULT=0
   SC_STATE.ACK=SC_HALT
ELSE
   IF SC_STATE.RUNNING<>0 THEN
      SC_ENDED(<R_STOPPED_BY_OTHER>)
   ENDIF
   SC_STATE.OWNER=0
ENDIF
SC_HALT=0
END

DEF SC_SESSION( )
; one session owns the arm; another one gets it if the owner is silent
IF SC_TAKE<0 THEN
   IF SC_STATE.OWNER==-SC_TAKE THEN
      SC_STATE.OWNER=0
   ENDIF
ELSE
   IF (SC_STATE.OWNER==0) OR $TIMER_FLAG[<TIMER>] THEN
      SC_STATE.OWNER=SC_TAKE
   ENDIF
ENDIF
SC_TAKE=0
END

DEF SC_EXECUTE( )
DECL INT NUMBER,AHEAD,WRONG,I
; one order; others than new ones of the owner are ignored
NUMBER=SC_ORDER.NUMBER
AHEAD=NUMBER-SC_STATE.ACK
IF AHEAD<0 THEN
   AHEAD=AHEAD+<LAST>
ENDIF
IF SC_STATE.ACK==0 THEN
   AHEAD=1
ENDIF
IF (SC_ORDER.SESSION<>SC_STATE.OWNER) OR (AHEAD==0) OR (AHEAD><HALF>) THEN
   SC_ORDER.NUMBER=0
   RETURN
ENDIF
WRONG=0
IF SC_ORDER.KIND==<RESET> THEN
   SC_STATE.FAULT=0
ELSE
   IF (SC_ORDER.COUNT<1) OR (SC_ORDER.COUNT><MAX_VIA>) THEN
      WRONG=<R_TOO_MANY_POINTS>
   ELSE
      FOR I=1 TO SC_ORDER.COUNT
         IF (SC_POINT[I].NUMBER<>NUMBER) OR (SC_POINT[I].SESSION<>SC_ORDER.SESSION) THEN
            WRONG=<R_INCOMPLETE>
         ENDIF
      ENDFOR
   ENDIF
   IF (SC_ORDER.SPEED<1) OR (SC_ORDER.SPEED>100) THEN
      WRONG=<R_SPEED>
   ENDIF
   IF SC_STATE.FAULT<>0 THEN
      WRONG=<R_IN_FAULT>
   ENDIF
ENDIF
IF (SC_ORDER.KIND==<RESET>) OR (WRONG<>0) THEN
   SC_STATE.RESULT=WRONG
   SC_STATE.ACK=NUMBER
   SC_ORDER.NUMBER=0
   RETURN
ENDIF
BAS(#VEL_PTP,SC_ORDER.SPEED)
BAS(#ACC_PTP,100)
SC_STATE.PASSED=0
SC_STATE.RUNNING=NUMBER
SC_STATE.RESULT=0
SC_STATE.ACK=NUMBER
SC_ORDER.NUMBER=0
INTERRUPT ON 20
INTERRUPT ON 21
INTERRUPT ON 22
SC_DRIVE( )
SC_DEAF( )
IF SC_STATE.PASSED==SC_ORDER.COUNT THEN
   SC_ENDED(0)
ENDIF
END

DEF SC_DRIVE( )
DECL INT I
; an interrupt needs a change: a stop or a silence from before INTERRUPT ON is seen here
FOR I=1 TO SC_ORDER.COUNT
   IF (SC_HALT<>0) OR $TIMER_FLAG[<TIMER>] THEN
      RETURN
   ENDIF
   PTP SC_POINT[I].AXES
   SC_STATE.PASSED=I
ENDFOR
END
"""
