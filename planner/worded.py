"""Enumerations whose members have a sentence for reports."""

from enum import IntEnum
from typing import Self


class Worded(IntEnum):
    """Members are declared as `NAME = number, sentence`; only the number is their value and is stored in files.

    Attributes:
        sentence: the member in words, for reports.
    """

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Self:
        """Create a member; `Kind(number)` looks one up."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member
