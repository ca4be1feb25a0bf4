"""The paper's experiments again, one figure a file, each with the fair comparison beside it."""

from typing import Literal, get_args

Name = Literal["object-sets", "best-worst", "sweeps", "controller", "non-symmetric", "full"]
NAMES: tuple[Name, ...] = get_args(Name)  # the cheap ones first
