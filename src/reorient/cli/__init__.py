"""The command line: one verb per capability. Errors are one line on standard error."""

import io
import os
import sys

from reorient import __version__
from reorient.cli.arguments import parse
from reorient.cli.verbs import VERBS, find, overview
from reorient.errors import ReorientError
from reorient.extras import extras_named
from reorient.plugins import LOGGER, tracebacks_shown

USAGE = """usage: reorient VERB [arguments] [options]

Rotate an object that was never seen before until it matches a depth image.
"""
TRACEBACK = "--traceback"  # of all verbs
END = """
options:
  -h, --help       Show this help, or that of a verb, and exit.
  --version        Show the version and exit.
  --traceback      With any verb: show where an error arose.

exit codes:
  0 success, 1 the loop did not converge, 2 bad input or no device, 130 interrupted"""


def main(arguments: list[str] | None = None) -> None:
    """Parse and run. Returns after success, else raises SystemExit with the codes that ``reorient --help`` lists."""
    words = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a character that the terminal lacks must not end a measurement
    with tracebacks_shown(TRACEBACK in words):
        _main([word for word in words if word != TRACEBACK])


def _main(words: list[str]) -> None:
    try:
        try:
            code = _run(words)
        finally:
            sys.stdout.flush()  # here, as a closed pipe cannot be caught when the interpreter ends
    except ReorientError as error:
        LOGGER.debug("the traceback of the error:", exc_info=error)
        print("reorient:", *map(str.strip, str(error).splitlines()), file=sys.stderr)  # user code may raise several
        sys.exit(2)
    except BrokenPipeError:  # the reader of the output has enough (reorient ... | head)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)  # 128 + SIGPIPE
    except OSError as error:  # a full disk
        print(f"reorient: {error.strerror or error} {error.filename or ''}".strip(), file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("reorient: interrupted", file=sys.stderr)
        sys.exit(130)
    if code:
        sys.exit(code)


def _run(words: list[str]) -> int | None:
    """The exit code of a command line."""
    if not words:
        raise ReorientError("no verb given (see reorient --help)")
    if words[0] == "--version":
        print("reorient", __version__)
        return 0
    name = find(words)
    if name is None:
        print(USAGE + overview(words[0] if len(words) > 1 else "") + "\n" + END)
        return 0
    with extras_named():
        return parse(VERBS[name].load(), f"reorient {name}", words[len(name.split()) :]).run()
