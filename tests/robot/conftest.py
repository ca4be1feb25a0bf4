"""ROS 2 of the tests: on this machine alone, in a domain of this process."""

import os
import sys

import pytest

_STATUS = pytest.StashKey[int]()
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


@pytest.fixture
def ros_domain(monkeypatch):
    domain = 1 + os.getpid() % 100
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    return domain


def pytest_sessionfinish(session, exitstatus):
    session.config.stash[_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """End without the interpreter's clean-up: the vendors' libraries, all in one process, crash in theirs."""
    if _STATUS in config.stash:
        sys.stdout.flush()
        os._exit(config.stash[_STATUS])
