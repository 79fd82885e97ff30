"""What the commands print: every ± is half of a 95 % interval, and it is said where it stands."""

from snapo.cli.answers import by_seed, summary

RESULT = {"kind": "pension", "status": "trained", "value": -0.2256, "standard_error": 0.0005}


def test_the_value_has_half_of_its_interval_and_no_row_of_a_standard_error():
    lines = summary(RESULT | {"meaning": "a probability"}).splitlines()
    assert lines[1].split(maxsplit=1) == ["value", "-0.2256 ± 0.00098 (95 %)   a probability"]
    assert not any("standard error" in line for line in lines)
    alone = summary({"kind": "own", "status": "ok", "value": 3.0}).splitlines()[1]
    assert alone.split() == ["value", "3"]


def test_a_fund_has_its_funding_ratio_and_its_leads():
    texts = ["certain funding ratio after 5 years: 102.61 % ± 0.10 (95 %)", "+10.0 ± 0.9 bp a year"]
    lines = summary(RESULT | {"references": {"present_mix": -0.27}, "description": texts})
    assert lines.splitlines()[-2:] == texts


def test_one_total_of_seconds():
    lines = summary(RESULT | {"seconds": {"training": 7.0, "report": 2.0, "total": 9.25}})
    assert [line.split() for line in lines.splitlines() if "seconds" in line] == [
        ["seconds", "9.2"]
    ]


def test_seeds_have_their_intervals_and_what_they_are():
    row = {"seed": 0, "value": 3.0, "status": "ok", "convergence": "", "seconds": 1.0}
    other = row | {"seed": 1, "value": 2.0, "below_best": 1.0, "below_best_error": 0.1}
    result = {"rows": [row, other], "best": 0, "paths": 64, "mean": 2.5, "worst": 2.0}
    result |= {"highest": 3.0, "deviation": 0.7, "standard_error": 0.05}
    _, _, second, last = by_seed(result)
    assert "1 ± 0.2" in second
    assert last.startswith("mean 2.5 ± 0.098, worst 2, best 3; ")
    assert "± is half of a 95 % interval on 64 common paths, simulation error only" in last
