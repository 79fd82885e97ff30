"""A verdict that concerns a decision stands on the first screen."""

from snapo.report.evidence import notes, with_verdicts
from snapo.report.folder import RunFiles, RunResult
from snapo.report.page import Headline, Mark, Section, Text

BEATEN = "The classical rule “hold” does better than the trained policy, by 3 ± 1."


def run(**entries) -> RunFiles:
    return RunFiles(RunResult(**entries), {}, {}, (), {}, {})


def first(of: RunFiles) -> Section:
    block = Headline("Value", "1", "", "", marks=[Mark(True, "all checks hold")])
    return Section("value", "Value", "", [block, *notes(of), Text("more")])


def test_a_rule_that_does_better_is_a_mark_once():
    beaten = run(verdict=BEATEN, notes=(BEATEN, "another note"))
    block, *others = with_verdicts(first(beaten), beaten).blocks
    assert block.marks == [Mark(True, "all checks hold"), Mark(False, BEATEN)]
    assert [text.text for text in others] == ["another note", "more"]


def test_a_policy_that_does_better_is_a_good_mark():
    ahead = run(verdict="The policy does better than the best fixed recipe: 99 % and 90 %.")
    assert with_verdicts(first(ahead), ahead).blocks[0].marks[-1] == Mark(
        True, ahead.result.verdict
    )


def test_nothing_changes_without_such_a_verdict():
    plain = run(verdict="At most 1 % can still be gained.", notes=("a note",))
    assert with_verdicts(first(plain), plain) == first(plain)
