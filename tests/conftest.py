"""Types and array shapes of the whole package are checked in every test; small fixtures that several files share."""

from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from jaxtyping import config, install_import_hook

install_import_hook("reorient", "typecheck.checked")

from reorient.imaging import Camera  # noqa: E402 - the package comes after its hook


@pytest.fixture
def unchecked() -> Iterator[None]:
    """No type checks: what a user meets who passes the wrong type."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def camera() -> Camera:
    """Nothing about it is square or centred, so that a swap of rows and columns shows."""
    return Camera(96, 72, 110.0, 104.0, 45.25, 33.5)


@pytest.fixture(scope="session")
def mesh() -> trimesh.Trimesh:
    """A corner of three arms of different lengths: no rotation maps it onto itself."""
    ends = ((1.0, 0.2, 0.2), (0.2, 0.7, 0.2), (0.2, 0.1, 0.5))
    arms = [trimesh.creation.box(bounds=[(-0.2, -0.2, -0.2), end]) for end in ends]
    return trimesh.boolean.union(arms, engine="manifold")
