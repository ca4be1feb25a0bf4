"""Errors that a user sees: what is wrong, what was expected, what to do."""

LARGEST = 1e15  # of a setting: what is computed from larger numbers overflows
MOST = 1_000_000  # of a count: a name and a task are kept in memory for each


class ReorientError(ValueError):
    """Bad input, described in one line; the command line prints it and exits with code 2."""


class StationError(ReorientError):
    """A camera or a robot failed: no frame, a refused move."""


class ProtocolError(ReorientError):
    """A station or an estimator of the user's own returned something other than its protocol requires."""


class OutOfRange(ReorientError):
    """A field of settings with a value outside its range. The command line replaces the field's name by its option."""

    def __init__(self, name: str, value: object, expected: str) -> None:
        super().__init__(f"{name}={in_short(value)}: expected {expected}")
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

    ``above``, ``below``: ``low`` and ``high`` themselves are outside. Every element of a tuple counts. An empty tuple,
    what is no number, and any number beyond 1e15 are outside. None is a setting that is not given.
    """
    expected = f"{'above' if above else 'from'} {low:.10g}" + (
        "" if high == float("inf") else f" {'and below' if below else 'to'} {high:.10g}"
    )
    for name in names:
        value = getattr(settings, name)
        values = value if isinstance(value, tuple) else () if value is None else (value,)
        inside = all(
            isinstance(x, int | float)
            and abs(x) <= LARGEST
            and (low < x if above else low <= x)
            and (x < high if below else x <= high)
            for x in values
        )
        if not inside or value == ():
            raise OutOfRange(name, value, f"{'numbers' if isinstance(value, tuple) else 'a number'} {expected}")


def check_counts(settings: object, *names: str) -> None:
    """Raise OutOfRange for the first of these fields that is no count from 1 to a million."""
    check_range(settings, *names, low=1, high=MOST)


def check_distinct(settings: object, *names: str) -> None:
    """Raise OutOfRange for the first of these fields, tuples, that has a value twice: its rows would count twice."""
    for name in names:
        values = getattr(settings, name)
        if len(set(values)) < len(values):
            raise OutOfRange(name, values, "each of them once")


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

    near = difflib.get_close_matches(name[:200], known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    listed = ", ".join(known[:20]) + (f", ... ({len(known)} in all)" if len(known) > 20 else "")
    return ReorientError(f"unknown {kind} {in_short(name)!r}: expected one of {listed}{hint}")


def reason_of(error: BaseException) -> str:
    """The reason for which a parser failed, in one short line: they raise a dozen kinds of errors on broken files."""
    if isinstance(error, ReorientError):
        return str(error)
    if isinstance(error, KeyError):
        return in_short(f"no {error}")
    return in_short(" ".join(f"{type(error).__name__}: {error}".split()), 200)


def in_short(value: object, most: int = 100) -> str:
    """The text of a value of any length and kind, as it fits into a message."""
    try:
        text = str(value)
    except ValueError:  # a number of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= most else f"{text[: most - 4]} ..."
