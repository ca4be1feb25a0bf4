"""The type checker of the tests, in a module of its own: every folder of tests has a ``conftest``."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int will do for a float, as everywhere in Python
