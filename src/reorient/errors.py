"""Errors that a user sees: what is wrong, what was expected, what to do."""

from math import isfinite


class ReorientError(ValueError):
    """Bad input, described in one line; the command line prints it and exits with code 2."""


class StationError(ReorientError):
    """A camera or a robot failed: no frame, a refused move."""


class ProtocolError(ReorientError):
    """A station or an estimator of the user's own returned something other than its protocol requires."""


class OutOfRange(ReorientError):
    """A field of settings with a value outside its range. The command line replaces the field's name by its option."""

    def __init__(self, name: str, value: object, expected: str) -> None:
        super().__init__(f"{name}={value}: expected {expected}")
        self.name, self.value, self.expected = name, value, expected


def check_range(
    settings: object,
    *names: str,
    low: float = 0.0,
    high: float = float("inf"),
    above: bool = False,
    below: bool = False,
) -> None:
    """Raise OutOfRange for the first of these fields that has a value outside the range.

    ``above``, ``below``: ``low`` and ``high`` themselves are outside. Every element of a tuple counts. An empty tuple
    and an infinite number are outside. None is a setting that is not given.
    """
    expected = f"{'above' if above else 'from'} {low:g}" + (
        "" if high == float("inf") else f" {'and below' if below else 'to'} {high:g}"
    )
    for name in names:
        value = getattr(settings, name)
        values = value if isinstance(value, tuple) else () if value is None else (value,)
        inside = all(
            isfinite(x) and (low < x if above else low <= x) and (x < high if below else x <= high) for x in values
        )
        if not inside or value == ():
            raise OutOfRange(name, value, f"{'numbers' if isinstance(value, tuple) else 'a number'} {expected}")


def check_angles(settings: object, name: str, above: bool = False) -> None:
    """Raise OutOfRange for a field of angle ranges in degrees that is empty or has a pair out of order or range.

    ``above``: 0 is outside.
    """
    for low, high in getattr(settings, name) or ((-1.0, -1.0),):
        if not low <= high <= 180 or low < 0 or (above and low == 0):
            raise OutOfRange(name, getattr(settings, name), f"0 {'<' if above else '<='} low <= high <= 180")


def unknown_name(kind: str, name: str, known: list[str]) -> ReorientError:
    """The error for an unknown name: it lists the known names, and suggests the nearest."""
    import difflib

    near = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    listed = ", ".join(known[:20]) + (f", ... ({len(known)} in all)" if len(known) > 20 else "")
    return ReorientError(f"unknown {kind} {name!r}: expected one of {listed}{hint}")
