"""`[report] title, author, note, logo` in a case of every kind."""

import pytest
from tests.miniatures import MINIATURES

from snapo.case.error import CaseError
from snapo.study.domain import load

TEXTS = ("title", "author", "note")


@pytest.mark.parametrize("kind", sorted(MINIATURES))
def test_every_kind_takes_them(kind, tmp_path):
    asked = MINIATURES[kind].write(tmp_path)
    texts = tuple(f'report.{name}="x"' for name in TEXTS)
    request = asked._replace(assignments=(*asked.assignments, *texts))
    assert load(request).data["report"]["author"] == "x"
    missing = request._replace(assignments=(*asked.assignments, 'report.logo="none.png"'))
    with pytest.raises(CaseError, match="there is no such file; it must be the name of a PNG"):
        load(missing)
