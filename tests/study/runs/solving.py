"""Solves a case of the fake domain, in a process of its own: CASE, seconds that each part takes."""

import sys
import time

import pytest
from tests.study import fake

from snapo.cli.main import main

case, seconds = sys.argv[1:]
start = fake._start


def slow(name: str, fails: str) -> None:
    time.sleep(float(seconds))
    start(name, fails)


fake._start = slow
with pytest.MonkeyPatch.context() as patch:
    fake.install(patch, fake="tests.study.fake:DOMAIN")
    sys.exit(main(["solve", case]))
