
  ! scan a view at rest; after a time-out stop, and repeat the scan on Start
  PROC scScan(num number)
    scScanned:=FALSE;
    WHILE NOT scScanned DO
      scBegin number;
      scEnd;
    ENDWHILE
  ENDPROC

  ! settle, wait until the answer to the previous view is gone, trigger
  PROC scBegin(num number)
    WaitTime scSettle;
    scView:=number;
    WaitDI scDone,0\MaxTime:=scTimeout\TimeFlag:=scLate;
    WHILE scLate DO
      TPWrite "scan-cell: scDone is still on from the previous view";
      Stop\NoRegain;
      WaitDI scDone,0\MaxTime:=scTimeout\TimeFlag:=scLate;
    ENDWHILE
    scStand;
    SetDO scTrigger,1;
  ENDPROC

  ! wait for the scanner and reset the trigger; scScanned is TRUE if it answered in time
  PROC scEnd()
    WaitDI scDone,1\MaxTime:=scTimeout\TimeFlag:=scLate;
    scScanned:=NOT scLate;
    SetDO scTrigger,0;
    IF scLate THEN
      TPWrite "scan-cell: time-out, no answer at view "\Num:=scView;
      Stop\NoRegain;
      scStand;
    ENDIF
  ENDPROC

  ! continue only from the end of the last motion: from elsewhere no path was checked
  PROC scStand()
    WHILE NOT scAtStop() DO
      TPWrite "scan-cell: the arm is not at its last stop; jog it there, then start";
      Stop\NoRegain;
      WaitTime scSettle;
    ENDWHILE
  ENDPROC

  ! TRUE if every axis is within scNear of the last stop
  FUNC bool scAtStop()
    VAR jointtarget scNow;
    scNow:=CJointT();
