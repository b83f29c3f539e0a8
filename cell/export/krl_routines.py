"""The parts of a KRL program that are the same in each: its beginning as KUKA's templates have it, and the routines.

    SC_SCAN(n)     scan view n at rest, again after each time-out
    SC_BEGIN(n)    stand calm, see that no answer is left, trigger
    SC_END()       wait for the answer or the time-out, take the trigger back
    SC_STAND()     halt until the arm is where the last motion ended, `SC_STOP`
    SC_CLOCK()     begin to measure the time-out

Their variables stand in the program's `.dat`.
"""

from collections.abc import Sequence

BEGIN = (
    ";FOLD INI",
    "  ;FOLD BASISTECH INI",
    "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "    INTERRUPT ON 3",
    "    BAS (#INITMOV,0 )",
    "  ;ENDFOLD (BASISTECH INI)",
    ";ENDFOLD (INI)",
)


def routines(axes: Sequence[str]) -> tuple[str, ...]:
    """The routines, for a robot whose axes have these names: A1 to A6, then external ones."""
    far = [(f"IF ABS($AXIS_ACT.{axis}-SC_STOP.{axis})>SC_NEAR THEN", "  RETURN FALSE", "ENDIF") for axis in axes]
    return (*_ROUTINES, *(line for lines in far for line in lines), "RETURN TRUE", "ENDFCT")


_ROUTINES = (
    "DEF SC_SCAN(NUMBER :IN )",
    "; scan a view at rest; after a time-out halt, and on Start scan it again",
    "DECL INT NUMBER",
    "SC_SCANNED=FALSE",
    "WHILE NOT SC_SCANNED",
    "  SC_BEGIN(NUMBER)",
    "  SC_END( )",
    "ENDWHILE",
    "END",
    "",
    "DEF SC_BEGIN(NUMBER :IN )",
    "; stand, see that the answer to the view before is gone, trigger",
    "DECL INT NUMBER",
    "WAIT SEC SC_SETTLE",
    "SC_VIEW=NUMBER",
    "SC_CLOCK( )",
    "WAIT FOR (NOT $IN[SC_DONE]) OR $TIMER_FLAG[SC_TIMER]",
    "WHILE $IN[SC_DONE]",
    "  HALT ; the answer to the view before did not go away",
    "ENDWHILE",
    "SC_STAND( )",
    "$OUT[SC_TRIGGER]=TRUE",
    "END",
    "",
    "DEF SC_END( )",
    "; wait for the scanner and take the trigger back; SC_SCANNED says whether it answered in time",
    "SC_CLOCK( )",
    "WAIT FOR $IN[SC_DONE] OR $TIMER_FLAG[SC_TIMER]",
    "SC_SCANNED=$IN[SC_DONE]",
    "$OUT[SC_TRIGGER]=FALSE",
    "$TIMER_STOP[SC_TIMER]=TRUE",
    "IF NOT SC_SCANNED THEN",
    "  HALT ; time-out: the scanner did not answer; SC_VIEW says at which view",
    "  SC_STAND( )",
    "ENDIF",
    "END",
    "",
    "DEF SC_CLOCK( )",
    "; begin to measure the time-out: the timer counts up, its flag is TRUE above 0",
    "$TIMER_STOP[SC_TIMER]=TRUE",
    "$TIMER[SC_TIMER]=-SC_TIMEOUT",
    "$TIMER_STOP[SC_TIMER]=FALSE",
    "END",
    "",
    "DEF SC_STAND( )",
    "; go on only from where the last motion ended: from elsewhere no way was checked",
    "WHILE NOT SC_AT_STOP()",
    "  HALT ; the arm is not at SC_STOP: bring it there by hand, then start again",
    "  WAIT SEC SC_SETTLE",
    "ENDWHILE",
    "END",
    "",
    "DEFFCT BOOL SC_AT_STOP( )",
    "; whether no axis is farther from the last stop than SC_NEAR [deg]",
)
