"""Text of numbers and results, equal in every report."""

import html
from base64 import b64encode
from collections.abc import Iterable
from pathlib import Path


def percent(share: float) -> str:
    """Format a share of 1 as a percentage."""
    return f"{100 * share:.2f} %"


def comma_list(values: Iterable[float]) -> str:
    """Join numbers by commas."""
    return ", ".join(f"{value:g}" for value in values)


class Summary:
    """Short text of a result: one line in a terminal, a table with a picture in a notebook."""

    __slots__ = ()

    def facts(self) -> list[tuple[str, str]]:
        """Return names and values of the most important facts; the first is the folder."""
        raise NotImplementedError

    @property
    def picture(self) -> Path | None:
        """Picture (PNG) of the result; None if it does not exist."""
        return None

    def __repr__(self) -> str:
        (_, folder), *facts = self.facts()
        return f"{type(self).__name__}({', '.join([repr(folder), *(f'{name} {value}' for name, value in facts)])})"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><th>{name}</th><td>{html.escape(value)}</td></tr>" for name, value in self.facts())
        table = f"<table>{rows}</table>"
        if self.picture is None or not self.picture.is_file():
            return table
        content = b64encode(self.picture.read_bytes()).decode()
        return f'{table}<img style="max-width:480px" src="data:image/png;base64,{content}">'
