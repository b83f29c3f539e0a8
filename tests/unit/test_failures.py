"""End of a command: exit code and error message, also with closed output streams."""

import errno
import io
import sys

import pytest

from cell.cli.failures import report_errors
from cell.errors import UsageError
from cell.signals import INTERRUPTED


class _Closed(io.StringIO):
    def write(self, text: str) -> int:
        raise OSError(errno.EIO, "Input/output error")


def test_ctrl_c_in_a_compiled_kernel_is_no_bug(capsys: pytest.CaptureFixture[str]) -> None:
    """Numba raises SystemError from the KeyboardInterrupt while it converts arguments or results."""

    def run() -> None:
        try:
            raise SystemError("returned a result with an exception set") from KeyboardInterrupt()
        except SystemError as error:
            raise SystemError("of the caller, another kernel") from error

    assert report_errors(run, as_json=False) == INTERRUPTED
    assert "stopped by Ctrl-C" in capsys.readouterr().err


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize(("raised", "code"), [(KeyboardInterrupt(), INTERRUPTED), (UsageError("no"), 2)])
def test_a_closed_terminal_holds_nothing_up(
    raised: BaseException, code: int, as_json: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exit code is returned although neither output stream accepts text."""

    def run() -> None:
        raise raised

    monkeypatch.setattr(sys, "stdout", _Closed())
    monkeypatch.setattr(sys, "stderr", _Closed())
    assert report_errors(run, as_json=as_json) == code
