"""Errors that a user sees: what is wrong, what was expected, what to do."""


class ReorientError(ValueError):
    """Bad input, described in one line; the command line prints it and exits with code 2."""


class StationError(ReorientError):
    """A camera or a robot failed: no frame, a refused move."""


def unknown_name(kind: str, name: str, known: list[str]) -> ReorientError:
    """The error for an unknown name: it lists the known names, and suggests the nearest."""
    import difflib

    near = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    listed = ", ".join(known[:20]) + (f", ... ({len(known)} in all)" if len(known) > 20 else "")
    return ReorientError(f"unknown {kind} {name!r}: expected one of {listed}{hint}")
