"""The command line: one verb per capability. Errors are one line on standard error and exit code 2."""

import sys
from typing import Any

import tyro

from reorient.cli.offline import Evaluate, Objects, Report
from reorient.cli.robot import Capture, Demo, Estimate, Orient
from reorient.errors import ReorientError

VERBS = (Demo, Estimate, Orient, Capture, Objects, Evaluate, Report)


def main(arguments: list[str] | None = None) -> None:
    """Parse and run; ends with code 0, 2 (bad input) or 130 (interrupted)."""
    try:
        verb: Any = tyro.extras.subcommand_cli_from_dict(
            {each.__name__.lower(): each for each in VERBS},
            prog="reorient",
            description="Turn a never-seen object to match a picture.",
            args=arguments,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
        )
        verb.run()
    except ReorientError as error:
        print(f"reorient: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("reorient: interrupted; what was finished is kept", file=sys.stderr)
        sys.exit(130)
