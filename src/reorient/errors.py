"""Errors for the user: the cause, the expected input, the remedy, in one line."""


class ReorientError(ValueError):
    """Bad input, with a message of one line; the command line prints it and exits with code 2."""


class StationError(ReorientError):
    """The camera or the robot failed: no frame, a refused move."""


def unknown_name(kind: str, name: str, known: list[str]) -> ReorientError:
    """The error for an unknown name; its message lists the known names and the most similar one."""
    import difflib

    near = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    listed = ", ".join(known[:20]) + (f", ... ({len(known)} in all)" if len(known) > 20 else "")
    return ReorientError(f"unknown {kind} {name!r}: expected one of {listed}{hint}")
