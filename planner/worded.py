"""Enumerations whose members say in words what they mean."""

from enum import IntEnum
from typing import Self


class Worded(IntEnum):
    """Members are declared as `NAME = number, sentence`; only the number is their value, and stands in files.

    Attributes:
        sentence: the member in words, for reports.
    """

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Self:
        """Make a member; `Kind(number)` looks one up."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member
