"""Numbers that go over wires, each with its sentence."""

from enum import IntEnum
from typing import Self


class Code(IntEnum):
    """A number with a sentence beside it; members are written `NAME = number, "sentence"`.

    Attributes:
        sentence: the number in words; empty where there is nothing to say.
    """

    sentence: str

    def __new__(cls, number: int, sentence: str = "") -> Self:
        """A member of its number."""
        code = int.__new__(cls, number)
        code._value_ = number
        code.sentence = sentence
        return code
