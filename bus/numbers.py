"""Numbers in messages: enough digits that a value and its bound do not contradict each other."""

from collections.abc import Callable

_MOST_DIGITS = 17
"""Significant digits that distinguish all numbers."""
_ROUNDING = 1e-12
"""Relative error of a computed limit, by rounding."""


def exact(number: float) -> str:
    """Return the shortest text that reads back as this number, such as 0.6 or 200."""
    return repr(float(number)).removesuffix(".0")


def enough_digits(number: float, holds: Callable[[float], bool], digits: int = 6) -> str:
    """Return a number, rounded to the fewest significant digits for which a statement about it still holds.

    Args:
        number: Number.
        holds: Statement about the printed number. If it does not hold for the number itself, it is ignored.
        digits: Fewest significant digits.
    """
    if not holds(number):
        return f"{number:.{digits}g}"
    texts = (f"{number:.{n}g}" for n in range(digits, _MOST_DIGITS))
    return next((text for text in texts if holds(float(text))), exact(number))


def above(number: float, bound: float, digits: int = 4) -> str:
    """Return a number with enough digits to show that it is above a bound, which is printed by `exact`."""
    return enough_digits(number, lambda shown: shown > bound, digits)


def below(number: float, bound: float, digits: int = 4) -> str:
    """Return a number with enough digits to show that it is below a bound, which is printed by `exact`."""
    return enough_digits(number, lambda shown: shown < bound, digits)


def at_least(limit: float, digits: int = 6) -> str:
    """Return a lower limit, not rounded down by more than rounding in its computation."""
    return enough_digits(limit, lambda shown: shown >= limit - _ROUNDING * abs(limit), digits)


def at_most(limit: float, digits: int = 6) -> str:
    """Return an upper limit, not rounded up by more than rounding in its computation."""
    return enough_digits(limit, lambda shown: shown <= limit + _ROUNDING * abs(limit), digits)
