"""Ranges of an option such as `--x 1000:1600:50`: first, last (inclusive) and step; or single values by commas."""

import math

from cell.errors import UsageError

_MOST = 1000


def values(option: str, text: str) -> tuple[float, ...]:
    """The values of a range, ascending as given.

    Args:
        option: the option's name, for the sentence.
        text: `first:last:step`, or numbers separated by commas.

    Raises:
        UsageError: if it is neither, the step has the wrong sign, or there are more than a thousand values.
    """
    wanted = f"{option} {text} must be first:last:step, for instance {option} 1000:1600:50, or numbers with commas"
    try:
        numbers = [float(piece) for piece in text.split(":" if ":" in text else ",")]
    except ValueError:
        raise UsageError(wanted) from None
    if not all(math.isfinite(number) for number in numbers):
        raise UsageError(wanted)
    if ":" not in text:
        return tuple(dict.fromkeys(numbers))
    if len(numbers) != 3 or numbers[2] == 0 or (numbers[1] - numbers[0]) * numbers[2] < 0:
        raise UsageError(wanted)
    first, last, step = numbers
    count = math.floor((last - first) / step + 1e-9) + 1
    if count > _MOST:
        raise UsageError(f"{option} {text} has {count} values; at most {_MOST} are allowed, so take a larger step")
    # Rounded to a nanometre, so that 0.1 three times is 0.3: the values are part of the keys of trials.
    return tuple(round(first + index * step, 9) for index in range(count))


def pairs(option: str, text: str) -> list[tuple[float, float]]:
    """Pairs such as `50-150,100-300`.

    Args:
        option: the option's name, for the sentence.
        text: pairs separated by commas.

    Raises:
        UsageError: if a piece is no pair of positive numbers, the first below the second.
    """
    found = []
    for piece in text.split(","):
        near, dash, far = piece.partition("-")
        try:
            pair = float(near), float(far)
        except ValueError:
            pair = math.nan, math.nan
        if not (dash and 0 < pair[0] < pair[1] < math.inf):
            raise UsageError(
                f"{option} {text} must be pairs of near and far limit, for instance {option} 50-150,100-300"
            )
        found.append(pair)
    return found
