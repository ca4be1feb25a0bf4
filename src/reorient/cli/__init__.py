"""The command line: one verb per capability. Errors are one line on standard error and exit code 2."""

import contextlib
import io
import re
import sys
from importlib import import_module
from typing import Any

import tyro

from reorient.errors import ReorientError

VERBS = {  # by the file that holds them; only the one asked for is imported, as others take meshes and rays with them
    "estimating": ("Estimate",),
    "robot": ("Demo", "Orient", "Replay", "Capture"),
    "offline": ("Objects", "Evaluate", "Report"),
    "learning": ("Generate", "Train", "Export"),
    "verifier": ("Verifier",),
    "loops": ("Loops",),
    "cell": ("Cell",),
    "reproducing": ("Reproduce",),
}


def main(arguments: list[str] | None = None) -> None:
    """Parse and run; ends with code 0, 2 (bad input) or 130 (interrupted)."""
    try:
        _parse(sys.argv[1:] if arguments is None else arguments).run()
    except ReorientError as error:
        print("reorient:", *map(str.strip, str(error).splitlines()), file=sys.stderr)  # a station may say several lines
        sys.exit(2)
    except OSError as error:  # a full disk, a closed pipe
        print(f"reorient: {error.strerror or error} {error.filename or ''}".strip(), file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("reorient: interrupted", file=sys.stderr)
        sys.exit(130)


def _parse(arguments: list[str]) -> Any:
    """The verb with its options. Raises ReorientError where tyro prints a box of several lines."""
    asked = [file for file, verbs in VERBS.items() if arguments and arguments[0].capitalize() in verbs]
    modules = {file: import_module(f"reorient.cli.{file}") for file in asked or VERBS}
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.extras.subcommand_cli_from_dict(
                {verb.lower(): getattr(module, verb) for file, module in modules.items() for verb in VERBS[file]},
                prog="reorient",
                description="Turn a never-seen object to match a picture.",
                args=arguments,
                config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
            )
    except SystemExit as ended:
        if ended.code != 2:
            raise
        words = " ".join(re.sub(r"[\u2500-\u257f]|-{9,}", " ", said.getvalue()).split())
        words = re.sub(r"^Value error Error parsing (?!--)\S+: ", "", words)  # a config's own refusal, not a flag's
        raise ReorientError(words.partition(" For full helptext")[0] + " (see --help)") from ended
