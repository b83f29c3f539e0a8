"""Fixed parts of every KRL program: the initialisation of KUKA's templates, and the routines.

    SC_SCAN(n)     scan view n at rest; repeat after each time-out
    SC_BEGIN(n)    settle, wait until the previous answer is gone, trigger
    SC_END()       wait for the answer or the time-out, reset the trigger
    SC_STAND()     halt until the arm is at the end of the last motion, `SC_STOP`
    SC_CLOCK()     start the time-out

Their variables are declared in the program's `.dat`.
"""

from collections.abc import Sequence

BEGIN = (
    ";FOLD INI",
    ";FOLD BASISTECH INI",
    "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "INTERRUPT ON 3",
    "BAS (#INITMOV,0 )",
    ";ENDFOLD (BASISTECH INI)",
    ";ENDFOLD (INI)",
)


def routines(axes: Sequence[str]) -> tuple[str, ...]:
    """Return the routines for axes of these names: A1 to A6, then external axes."""
    tests = [(f"IF ABS($AXIS_ACT.{axis}-SC_STOP.{axis})>SC_NEAR THEN", "   RETURN FALSE", "ENDIF") for axis in axes]
    return (*_ROUTINES, *(line for lines in tests for line in lines), "RETURN TRUE", "ENDFCT")


_ROUTINES = (
    "DEF SC_SCAN(NUMBER :IN )",
    "DECL INT NUMBER",
    "; scan a view at rest; after a time-out halt, and repeat the scan on Start",
    "SC_SCANNED=FALSE",
    "WHILE NOT SC_SCANNED",
    "   SC_BEGIN(NUMBER)",
    "   SC_END( )",
    "ENDWHILE",
    "END",
    "",
    "DEF SC_BEGIN(NUMBER :IN )",
    "DECL INT NUMBER",
    "; settle, wait until the answer to the previous view is gone, trigger",
    "WAIT SEC SC_SETTLE",
    "SC_VIEW=NUMBER",
    "SC_CLOCK( )",
    "WAIT FOR (NOT $IN[SC_DONE]) OR $TIMER_FLAG[SC_TIMER]",
    "WHILE $IN[SC_DONE]",
    "   HALT ; the scanner did not reset its answer to the previous view",
    "ENDWHILE",
    "SC_STAND( )",
    "$OUT[SC_TRIGGER]=TRUE",
    "END",
    "",
    "DEF SC_END( )",
    "; wait for the scanner and reset the trigger; SC_SCANNED is TRUE if it answered in time",
    "SC_CLOCK( )",
    "WAIT FOR $IN[SC_DONE] OR $TIMER_FLAG[SC_TIMER]",
    "SC_SCANNED=$IN[SC_DONE]",
    "$OUT[SC_TRIGGER]=FALSE",
    "$TIMER_STOP[SC_TIMER]=TRUE",
    "IF NOT SC_SCANNED THEN",
    "   HALT ; time-out: the scanner did not answer; SC_VIEW is the view",
    "   SC_STAND( )",
    "ENDIF",
    "END",
    "",
    "DEF SC_CLOCK( )",
    "; start the time-out: the timer counts up, its flag is TRUE above 0",
    "$TIMER_STOP[SC_TIMER]=TRUE",
    "$TIMER[SC_TIMER]=-SC_TIMEOUT",
    "$TIMER_STOP[SC_TIMER]=FALSE",
    "END",
    "",
    "DEF SC_STAND( )",
    "; continue only from the end of the last motion: from elsewhere no path was checked",
    "WHILE NOT SC_AT_STOP()",
    "   HALT ; the arm is not at SC_STOP: bring it there by hand, then start again",
    "   WAIT SEC SC_SETTLE",
    "ENDWHILE",
    "END",
    "",
    "DEFFCT BOOL SC_AT_STOP( )",
    "; TRUE if every axis is within SC_NEAR [deg] of the last stop",
)
