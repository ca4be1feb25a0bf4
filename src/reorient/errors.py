"""What a user sees when something is wrong: what it was, what was expected, what to do."""


class ReorientError(ValueError):
    """Bad input, said in one line; the command line prints it and exits with code 2."""


class StationError(ReorientError):
    """The camera or the robot failed: no frame, a refused move."""


def unknown_name(kind: str, name: str, known: list[str]) -> ReorientError:
    """The error for a name that nothing answers to: names all that would, and the nearest."""
    import difflib

    near = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    listed = ", ".join(known[:20]) + (f", ... ({len(known)} in all)" if len(known) > 20 else "")
    return ReorientError(f"unknown {kind} {name!r}: expected one of {listed}{hint}")
